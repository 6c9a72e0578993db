"""Numbers of packets whose order is known."""

from __future__ import annotations

from poser.live.packets import SEQUENCE_MODULUS
from poser.live.sources import order
from poser.live.sources.order import InOrder


def test_each_device_is_counted_and_names_are_bounded() -> None:
    numbers = InOrder()
    assert [numbers.number(d) for d in "aabab"] == [1, 2, 1, 3, 2]
    for k in range(order.MOST - 2):
        numbers.number(f"x{k}")
    assert numbers.number("a") == 4  # heard lately enough
    for k in range(order.MOST):
        numbers.number(f"y{k}")
    assert numbers.number("a") == 1


def test_the_count_wraps() -> None:
    numbers = InOrder()
    found = [numbers.number("a") for _ in range(SEQUENCE_MODULUS + 1)]
    assert found[-2:] == [0, 1]
