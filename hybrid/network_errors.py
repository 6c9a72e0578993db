"""How wrong the network may be: deviations and covariance of its errors at the free joints."""

from __future__ import annotations

import numpy as np

from hybrid.settings import TrackerSettings
from mocap.estimator import Pose
from mocap.orientation import Array


class NetworkErrors:
    """Of the joints `free` (F,), by what poses state and, where they state nothing, by the settings."""

    def __init__(self, settings: TrackerSettings, free: tuple[int, ...]) -> None:
        self._free = list(free)
        self._scale, self._plain = (
            np.tile(np.broadcast_to(np.asarray(x, float), 24)[self._free], (3, 1)).T
            for x in (settings.network_scale, np.deg2rad(settings.network_sigma_deg))
        )
        self._floor = np.deg2rad(settings.network_floor_deg)
        self._ceiling = np.deg2rad(settings.network_ceiling_deg)
        self._identity = np.eye(3 * len(free))
        # The covariance seen last and what follows from it: a cache, nothing that a frame hands on.
        self._known: tuple[Array, tuple[Array, Array] | None] | None = None

    def of(self, pose: Pose) -> tuple[Array, Array]:
        """sigma (F,3) rad and L (3F,3F) with L^T L the inverse of the covariance.

        The covariance is the network's where it gives one: errors of joints along a limb lean against each
        other, and without that the limb's end would seem less certain than it is. Otherwise it is the
        diagonal of the deviations.
        """
        if pose.covariance is not None:
            if self._known is None or self._known[0] is not pose.covariance:
                self._known = (pose.covariance, self._whitened(pose.covariance))
            if self._known[1] is not None:
                return self._known[1]
        sigma = self._sigma(pose)
        return sigma, self._identity / sigma.ravel()

    def _whitened(self, covariance: Array) -> tuple[Array, Array] | None:
        """`of` a covariance (72,72); None where it is not one."""
        rows = (3 * np.array(self._free)[:, None] + np.arange(3)).ravel()
        C = covariance[np.ix_(rows, rows)]
        C = C + self._floor**2 * self._identity
        try:
            whitener = np.linalg.inv(np.linalg.cholesky(C))
        except np.linalg.LinAlgError:  # not positive definite
            return None
        return np.sqrt(C.diagonal()).reshape(-1, 3), whitener

    def _sigma(self, pose: Pose) -> Array:
        """(F,3) rad: the network's deviation of the free joints, scaled and kept in bounds."""
        sigma = self._plain
        if pose.std_rad is not None:
            stated = pose.std_rad[self._free]
            known = np.isfinite(stated) & (stated > 0)
            sigma = np.where(known, stated * self._scale, sigma)
        return np.minimum(np.maximum(sigma, self._floor), self._ceiling)
