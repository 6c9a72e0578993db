"""A model as an online estimator."""

from __future__ import annotations

from learned.model import Model
from learned.online.estimator import Online, RollingWindow
from learned.runtime import Precision, prepare
from learned.spec import named
from mocap import checked
from mocap.errors import PoserError
from mocap.skeleton import Skeleton


def stream(
    model: Model,
    rate_hz: float,
    sensors: tuple[str, ...] | None = None,
    places: tuple[str, ...] | None = None,
    *,
    window: tuple[int, int] | None = None,
    skeleton: Skeleton | None = None,
    precision: Precision = "float32",
) -> Online:
    """The estimator of a model for samples at `rate_hz`.

    sensors: as the recording names them (default: all places of the network); places: which of the network's
    places each stands for (default: by name). window: frames before and after the one answered for (default:
    the specification's). skeleton: whose pelvis height the poses have. precision: of the recurrent matrices
    (`learned.runtime`). Raises SensorError for sensors that do not fit, PoserError for a window or a rate.
    """
    checked.instance(model, Model, "stream: model", PoserError)
    if any(x.is_meta for x in model.state_dict().values()):
        raise PoserError("stream: the model's weights hold no numbers (device meta)")
    spec = model.config.specification
    sensors = spec.places if sensors is None else tuple(sensors)
    places = sensors if places is None else tuple(places)
    rolling: RollingWindow = named(spec.online)(
        model, sensors, places, window, prepare(model, precision)
    )
    return Online(rolling, rate_hz, skeleton, spec.tracker)
