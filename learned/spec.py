"""What the rest of the system knows of a network: one `Specification` each, without torch.

A new network is one folder with a `SPECIFICATION` and a line in `learned.registry`. Its model, the class that
`model` names, is a `learned.model.Model`: inputs and targets, loss, poses.
"""

from __future__ import annotations

import importlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, eq=False)
class Specification:
    """A network, as data.

    name: on the command line, in descriptions of weights, and of its shipped weights' file.
    title: as people call it.
    rate_hz: frames per second that it reads.
    places: the sensor places that it reads, in this order (`mocap.sensors`).
    combinations: the sets of these, as indices, that it is trained on; one set: it needs them all.
    architectures: what its `Config.architecture` may be, the default first.
    fixed_widths: those of them whose layers have widths of their own, whatever `Config.hidden` says.
    experiments: the settings of its own that `poser train` may vary, by their options.
    window: frames before and after the one answered for, online.
    window_changes: whether another window may be asked for.
    most_windows: of a validation set, so that it takes a CPU seconds.
    schedule: fields of `TrainSettings` that its paper states and that are not their defaults.
    tracker: fields of `hybrid.TrackerSettings` around it that are not their defaults.
    refiners: what can be put around its estimator, by the word behind the name (`imuposer-adam`), as
    `module:Class`; called with the estimator and each sensor's joint.
    everyday: sets of places to choose where there is more than it reads and nobody chose, best first.
    model: its `Model`, as `module:Class`; imported, as all of these, once it is needed.
    online: makes the window that the online runner feeds, as `module:function` called with the model, the
    sensors' names, the place that each stands for, the window (None: the one above) and a
    `learned.runtime.Runtime`; gives a `learned.online.estimator.RollingWindow`.
    deviations: fits what the model says of its own errors, as `module:function`; called as
    `learned.training.deviations.calibrate` is.
    """

    name: str
    title: str
    rate_hz: float
    places: tuple[str, ...]
    combinations: tuple[tuple[int, ...], ...]
    architectures: tuple[str, ...]
    window: tuple[int, int]
    most_windows: int
    model: str
    online: str
    deviations: str
    fixed_widths: tuple[str, ...] = ()
    experiments: tuple[str, ...] = ()
    window_changes: bool = False
    schedule: Mapping[str, Any] = field(default_factory=dict)
    tracker: Mapping[str, Any] = field(default_factory=dict)
    refiners: Mapping[str, str] = field(default_factory=dict)
    everyday: tuple[tuple[str, ...], ...] = ()

    @property
    def needs_all(self) -> bool:
        """Whether it reads all of its places or nothing."""
        return len(self.combinations) == 1

    @property
    def most(self) -> int:
        """Sensors that it is trained on at a time, at most."""
        return max(map(len, self.combinations))

    def trained_on(self, worn: Collection[str]) -> bool:
        """Whether it is trained on sensors at these places together; nothing worn yet is no matter."""
        have = {self.places.index(p) for p in worn}
        return not have or have in map(set, self.combinations)


def named(path: str) -> Any:
    """What `module:name` names."""
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)
