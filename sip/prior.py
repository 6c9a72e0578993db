"""The pose prior: mean, covariance and limits of the 69 body angles, from training motion only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from mocap.errors import FormatError
from mocap.orientation import Array


@dataclass(frozen=True, eq=False)
class Prior:
    """mean (69,) rad, covariance (69,69) rad^2, lower and upper limits (69,) rad of the body angles.

    roughness (69,): relative size of each angle's second difference in training motion, mean one over
    the joints that move. poses (P,69) rad: a thinned bank of training poses.
    """

    mean: Array
    covariance: Array
    lower: Array
    upper: Array
    roughness: Array
    poses: Array

    def given(self, active: tuple[int, ...], floor: float) -> Conditioned:
        """The prior of the angles of some body joints, and what they tell about the others.

        floor: rad, a standard deviation that is added to every angle's own, so that angles that hardly move
        do not rule the others.
        """
        a = (
            np.concatenate([np.r_[3 * j - 3 : 3 * j] for j in active])
            if active
            else np.zeros(0, int)
        )
        b = np.setdiff1d(np.arange(69), a)
        S = self.covariance
        gain = np.linalg.solve(S[np.ix_(a, a)] + floor**2 * np.eye(len(a)), S[np.ix_(a, b)]).T
        rest = S[np.ix_(b, b)] - gain @ S[np.ix_(a, b)]
        return Conditioned(self, a, b, gain, rest, floor)

    @classmethod
    def load(cls, path: Path) -> Prior:
        """Read a prior made by `scripts/make_prior.py`; raises FormatError."""
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as f:
                parts = {k: np.asarray(f[k], float) for k in cls.__dataclass_fields__}
        except (OSError, ValueError, KeyError, EOFError, BadZipFile) as e:
            raise FormatError(path, f"not a prior file ({e})") from e
        shapes: dict[str, tuple[int, ...]] = {
            "covariance": (69, 69),
            "poses": (*parts["poses"].shape[:1], 69),
        } | dict.fromkeys(("mean", "lower", "upper", "roughness"), (69,))
        for name, shape in shapes.items():
            if parts[name].shape != shape or not np.isfinite(parts[name]).all():
                raise FormatError(path, f"must be finite with shape {shape}", name)
        return cls(**parts)


@dataclass(frozen=True, eq=False)
class Conditioned:
    """A Gaussian over 69 angles, split into active ones (a,) and passive ones (b,).

    Passive joints are above no sensor: no measurement depends on them, so the posterior's mean for them is
    mean_b + gain (theta_a - mean_a), gain = Sigma_ba (Sigma_aa + floor^2 I)^-1, exactly, and they need no
    unknowns. rest (b,b): what remains uncertain of them. floor: rad, as in `Prior.given`.
    """

    prior: Prior
    active: Array
    passive: Array
    gain: Array
    rest: Array
    floor: float

    @property
    def mean(self) -> Array:
        """(a,) rad."""
        return self.prior.mean[self.active]

    @property
    def covariance(self) -> Array:
        """(a,a) rad^2, without the floor."""
        return self.prior.covariance[np.ix_(self.active, self.active)]

    @property
    def lower(self) -> Array:
        """(a,) rad."""
        return self.prior.lower[self.active]

    @property
    def upper(self) -> Array:
        """(a,) rad."""
        return self.prior.upper[self.active]

    @property
    def roughness(self) -> Array:
        """(a,) relative size of the angles' second differences, as in `Prior`."""
        return self.prior.roughness[self.active]

    def complete(self, theta: Array) -> Array:
        """All angles (T,69) rad from the active ones (T,a); passive ones are kept within their limits."""
        out = np.empty((len(theta), 69))
        out[:, self.active] = theta
        passive = self.prior.mean[self.passive] + (theta - self.mean) @ self.gain.T
        b = self.passive
        out[:, b] = np.clip(passive, self.prior.lower[b], self.prior.upper[b])
        return out

    def complete_variance(self, covariance: Array) -> Array:
        """Variances (T,69) rad^2 from the covariance (T,a,a) of the active angles."""
        out = np.empty((len(covariance), 69))
        out[:, self.active] = np.einsum("tii->ti", covariance)
        spread = np.einsum("bi,tij,bj->tb", self.gain, covariance, self.gain, optimize=True)
        out[:, self.passive] = spread + np.maximum(np.diag(self.rest), 0) + self.floor**2
        return out


@cache
def shipped() -> Prior:
    """The prior that comes with the package."""
    with as_file(files("sip").joinpath("prior.npz")) as path:
        return Prior.load(path)
