"""The jitter buffer against known motion: what arrives late, twice, shuffled, or not at all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocap import orientation as ori
from poser.live.assembler import Assembler, Row
from poser.live.device_clock import JUMP_S, DeviceClock, PacketNumbers
from poser.live.packets import Packet

RATE = 50.0
SPIN = np.array([0.3, 1.1, -0.5])  # rad/s


def orientation(t: float) -> np.ndarray:
    return ori.exp(SPIN * t)


def packet(device: str, t: float, k: int | None, origin: float = 0.0) -> Packet:
    """What a device that turns at a constant rate says at true time t, its clock at t + origin."""
    seq = None if k is None else k % 65536
    return Packet(device, t + origin, orientation(t), np.array([t, -t, 1.0]), seq)


Arrivals = list[tuple[float, Packet]]


def run(
    arrivals: Arrivals, devices: tuple[str, ...] = ("a",), until: float | None = None, **kw: float
):
    """Packets through an assembler that is asked every 5 ms; rows with the time they came out."""
    box = Assembler(devices, RATE, **kw)  # type: ignore[arg-type]
    arrivals = sorted(arrivals, key=lambda a: a[0])
    end = (arrivals[-1][0] + 0.2) if until is None else until
    rows: list[tuple[float, Row]] = []
    i = 0
    for now in np.arange(arrivals[0][0], end, 0.005):
        while i < len(arrivals) and arrivals[i][0] <= now + 1e-12:
            box.push(arrivals[i][1], arrivals[i][0])
            i += 1
        rows += [(float(now), r) for r in box.pull(float(now))]
    return box, rows


def steady(n: int, device: str = "a", origin: float = 0.0, start: int = 0) -> Arrivals:
    """n packets, each arriving the moment it is sent."""
    return [(k / RATE, packet(device, k / RATE, start + k, origin)) for k in range(n)]


def assert_true(rows: list[tuple[float, Row]], tolerance: float = 1e-9) -> None:
    """Every valid sample equals the motion at its row's time."""
    for _, row in rows:
        for d in np.flatnonzero(row.valid):
            off = ori.angle_between(row.R_world_sensor[d], orientation(row.time_s))
            assert off < tolerance
            assert row.acc_world[d] == pytest.approx([row.time_s, -row.time_s, 1.0], abs=tolerance)


def test_packets_on_time_come_back_as_they_are_and_at_once() -> None:
    box, rows = run(steady(30, origin=1e4))
    assert_true(rows)
    assert all(row.valid.all() for _, row in rows[:30])
    # Nothing is waited for: each row leaves as its packet comes (asked every 5 ms).
    assert max(now - row.time_s for now, row in rows[:30]) < 0.006
    assert box.counts["a"].lost == box.counts["a"].late == 0


def test_rows_between_packets_are_interpolated_on_the_manifold() -> None:
    late = [(t + 0.007, packet("b", t, k)) for k, t in enumerate(np.arange(0, 0.6, 1 / 33))]
    _, rows = run(steady(30) + late, ("a", "b"))
    # b's packets take 7 ms each: its row times are 7 ms off, nothing else.
    valid = [r for _, r in rows if r.valid[1]]
    assert len(valid) >= 28
    for row in valid[1:26]:
        off = ori.angle_between(row.R_world_sensor[1], orientation(row.time_s - 0.007))
        assert off < 1e-6


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_shuffled_doubled_and_lost_packets_make_no_false_sample(data: st.DataObject) -> None:
    n = 40
    delays = data.draw(st.lists(st.floats(0, 0.045), min_size=n, max_size=n))
    lost = data.draw(st.sets(st.integers(1, n - 2), max_size=15))
    double = data.draw(st.sets(st.integers(0, n - 1), max_size=10))
    start = data.draw(st.sampled_from([0, 65530, 65535]))
    numbered = data.draw(st.booleans())
    delays[0] = 0.0  # the clock's offset is known from the first packet on
    arrivals: Arrivals = []
    for k in set(range(n)) - lost:
        p = packet("a", k / RATE, start + k if numbered else None, origin=-70.0)
        arrivals.append((k / RATE + delays[k], p))
        if k in double:
            arrivals.append((k / RATE + delays[k] + 0.003, p))
    box, rows = run(arrivals, delay_s=0.05)
    times = [r.time_s for _, r in rows]
    assert times == [k / RATE for k in range(len(times))]
    held = []
    for k, (now, row) in enumerate(rows[:n]):
        assert now - row.time_s < 0.05 + 0.006
        if k not in lost:
            assert row.valid.all()
            assert ori.angle_between(row.R_world_sensor[0], orientation(row.time_s)) < 1e-7
        elif row.valid.all():
            # Interpolated (exact for this motion), or the nearest neighbour stands in.
            held.append(float(ori.angle_between(row.R_world_sensor[0], orientation(row.time_s))))
    assert all(h < 1.001 * np.linalg.norm(SPIN) / RATE for h in held)
    counts = box.counts["a"]
    assert counts.duplicates == len(double - lost)
    assert counts.received == len(arrivals)
    if numbered:
        assert counts.lost == len(lost)
    assert counts.jumps == counts.clock == 0


def test_packets_later_than_the_buffer_are_counted_and_change_nothing() -> None:
    arrivals = steady(40)
    arrivals[20] = (arrivals[20][0] + 0.12, arrivals[20][1])
    box, rows = run(arrivals)
    assert box.counts["a"].late == 1
    assert_true(rows[:20] + rows[21:40])


def test_a_silent_device_is_invalid_and_does_not_hold_up_the_others() -> None:
    b = [a for a in steady(100, "b") if not 0.5 < a[0] < 1.5]
    box, rows = run(steady(100) + b, ("a", "b"))
    valid = np.array([r.valid for _, r in rows[:100]])
    t = np.arange(100) / RATE
    assert valid[:, 0].all()
    assert valid[t <= 0.5, 1].all() and valid[t >= 1.5, 1].all()
    # The nearest packet stands in for one period at each edge of the silence.
    assert not valid[(t > 0.53) & (t < 1.47), 1].any()
    assert np.isnan(rows[50][1].R_world_sensor[1]).all()
    assert box.counts["b"].silent_rows >= 45
    assert_true(rows[:26] + rows[76:100])


def test_a_device_that_never_speaks_costs_the_delay_and_no_more() -> None:
    box, rows = run(steady(60), ("a", "absent"))
    assert all(r.valid.tolist() == [True, False] for _, r in rows[:60])
    assert all(now - row.time_s < 0.056 for now, row in rows)
    assert "absent" in box.silent(1.0)


@pytest.mark.parametrize("jump", [-3600.0, -2.0, 1.5, 1e9])
def test_a_clock_jump_costs_half_a_second(jump: float) -> None:
    before = steady(100)
    after = [
        (2.0 + k / RATE, packet("a", 2.0 + k / RATE, 100 + k, origin=jump)) for k in range(100)
    ]
    box, rows = run(before + after)
    assert box.counts["a"].jumps == 1
    valid = np.array([r.valid[0] for _, r in rows[:200]])
    assert valid[:100].all() and valid[128:].all()
    # A clock of 1e9 s is good to 1e-7 s.
    assert_true(rows[:200], tolerance=0.04)
    assert_true(rows[130:200], tolerance=1e-5)


def test_packets_refused_for_their_clock_are_not_lost() -> None:
    jump = [(k / RATE, packet("a", k / RATE, k, 0.0 if k < 300 else 1000.0)) for k in range(600)]
    box, _ = run(jump)
    counts = box.counts["a"]
    assert (counts.received, counts.lost, counts.jumps) == (600, 0, 1)
    assert 0.5 * RATE <= counts.clock < 0.6 * RATE


def test_a_device_that_starts_again_is_used_again() -> None:
    """Its clock and its numbers begin anew: the numbers that it sent before are no duplicates."""
    again = [(2.0 + t, p) for t, p in steady(100)]
    box, rows = run(steady(100) + again)
    counts = box.counts["a"]
    assert (counts.jumps, counts.lost) == (1, 0)
    valid = np.array([r.valid[0] for _, r in rows[:200]])
    assert valid[:100].all() and valid[128:].all()


def test_one_packet_of_another_time_does_not_move_the_clock() -> None:
    for stray in (1e6, -1e6, 5.0, -5.0):
        odd = [(k / RATE + 0.001, packet("a", k / RATE, None, stray)) for k in (30, 31, 60)]
        box, rows = run(steady(100) + odd)
        assert box.counts["a"].clock == 3
        assert box.counts["a"].jumps == 0
        assert_true(rows[:100])


def test_a_stall_of_the_network_is_no_jump() -> None:
    # Packets of 1 s to 3 s come at once at 3 s, then all is well again.
    arrivals = [(3.0 if 1.0 < t <= 3.0 else t, p) for t, p in steady(200)]
    box, rows = run(arrivals)
    assert box.counts["a"].jumps == 0
    assert_true(rows[:50] + rows[155:200])


def test_a_loop_that_stood_still_leaves_rows_out() -> None:
    box = Assembler(("a",), RATE)
    for t, p in steady(10):
        box.push(p, t)
    box.pull(0.1)
    rows = box.pull(3600.0)
    assert len(rows) < 200
    assert box.skipped > 3500 * RATE
    assert rows[-1].time_s == pytest.approx(3600.0 - box.delay_s, abs=2 / RATE)


def test_what_came_while_the_loop_stood_still_has_its_rows() -> None:
    """Five seconds of packets found at once; then nothing for an hour, and packets again."""
    box = Assembler(("a",), RATE)
    sent = steady(round(5 * RATE))
    for _, p in sent:
        box.push(p, 0.0 if p is sent[0][1] else 5.0, 0.001)
    rows = box.pull(5.0)
    assert box.skipped == 0 and len(rows) > 4.9 * RATE
    assert_true([(5.0, row) for row in rows])
    assert len(box.pull(3600.0)) < 200 and box.skipped > 3500 * RATE


def test_the_buffer_is_bounded() -> None:
    box = Assembler(("a",), RATE)
    for k in range(5000):
        box.push(packet("a", 1e-5 * k, None), 1e-5 * k)
    assert len(box._streams["a"].kept) <= 2048


@given(st.lists(st.floats(0, 0.2), min_size=3, max_size=60), st.floats(-1e6, 1e6))
def test_the_offset_is_that_of_the_quickest_packet(delays: list[float], origin: float) -> None:
    clock = DeviceClock()
    for k, delay in enumerate(delays):
        assert clock.hear(k / RATE + origin, k / RATE + delay) == "in time"
    assert clock.offset == pytest.approx(min(delays) - origin, abs=1e-9)


def test_drift_is_followed() -> None:
    clock, drift = DeviceClock(), 1e-3
    for k in range(5000):
        t = k / RATE
        assert clock.hear(t * (1 - drift), t) == "in time"
    assert abs(clock.offset - drift * 5000 / RATE) < 1e-3 * 10 + 1e-4 < JUMP_S


def test_what_may_have_come_in_time_is_in_time() -> None:
    """Found 0.6 s after it was sent: late, unless nobody had looked since before it was due."""
    clock = DeviceClock()
    assert clock.hear(0.0, 5.0) == "in time"
    assert clock.hear(0.1, 5.7, since_s=5.69) == "doubtful"
    assert clock.hear(0.1, 5.7, since_s=5.34) == "in time"
    assert clock.hear(0.1, 5.7, since_s=5.36) == "doubtful"
    assert clock.hear(9.0, 5.7, since_s=5.34) == "doubtful"  # from the future: a jump, no wait
    assert clock.offset == 5.0


@given(st.integers(0, 65535), st.lists(st.integers(0, 400), min_size=1, unique=True))
def test_packet_numbers_wrap(start: int, heard: list[int]) -> None:
    numbers = PacketNumbers()
    words = [numbers.hear((start + k) % 65536)[1] for k in heard]
    assert numbers.lost == max(heard) - min(heard) + 1 - len(heard)
    assert "duplicate" not in words
    assert all(numbers.hear((start + k) % 65536)[1] == "duplicate" for k in heard)


def test_a_device_that_starts_again_loses_nothing() -> None:
    numbers = PacketNumbers()
    said = [numbers.hear(k) for k in (20000, 20001, 20004, 0, 1, 2, 2)]
    assert [w for _, w in said] == ["next"] * 6 + ["duplicate"]
    assert numbers.lost == 2
    assert len({n for n, _ in said}) == 6


def test_nothing_of_a_refused_packet_stays() -> None:
    """Packets with the true numbers and wrong clocks, before every true one: all true ones count."""
    true = steady(300)
    forged = [
        (t - 0.002, packet("a", k / RATE, k, origin))
        for k, (t, _) in enumerate(true)
        for origin in (5.0, -40.0, 1e9 + 7 * k)
        if k
    ]
    box, rows = run([*true, *forged])
    counts = box.counts["a"]
    assert counts.clock == len(forged)
    assert counts.duplicates == counts.lost == counts.jumps == 0
    assert all(row.valid[0] for _, row in rows[:295])
    assert_true(rows[:295])


def test_two_senders_of_one_name_do_not_disturb_each_other() -> None:
    """The first one is heard as if alone, the second one once nothing more comes of it."""
    mine, other = ("127.0.0.1", 4000), ("127.0.0.1", 5000)
    alone, both = Assembler(("a",), 60.0), Assembler(("a",), 60.0)
    last = {"alone": [], "both": []}  # type: ignore[var-annotated]
    for k in range(120):
        t = k / 60.0
        packet = Packet("a", 100.0 + t, np.eye(3), np.full(3, t), k, None, mine)
        for made, name in ((alone, "alone"), (both, "both")):
            made.push(packet, t)
            last[name] += made.pull(t)
        if k > 2:
            # Another clock, numbers that the first is about to use.
            both.push(Packet("a", 7.0 + t, np.eye(3), np.full(3, -1.0), k + 1, None, other), t)
    assert len(last["both"]) == len(last["alone"]) > 100
    for a, b in zip(last["alone"], last["both"], strict=True):
        np.testing.assert_array_equal(a.acc_world, b.acc_world)
    counts = both.counts["a"]
    assert (counts.others, counts.duplicates, counts.lost, counts.clock) == (117, 0, 0, 0)
    for k in range(120, 240):
        t = k / 60.0
        both.push(Packet("a", 7.0 + t, np.eye(3), np.full(3, -1.0), k + 1, None, other), t)
        last["both"] += both.pull(t)
    assert last["both"][-1].valid.all() and last["both"][-1].acc_world[0, 0] == -1.0


def test_a_sender_with_a_socket_for_each_packet_is_one_sender() -> None:
    made = Assembler(("a",), 60.0)
    for k in range(60):
        sender = ("127.0.0.1", 4000 + k)
        made.push(Packet("a", k / 60.0, np.eye(3), np.zeros(3), k, None, sender), k / 60.0)
    counts = made.counts["a"]
    assert (counts.received, counts.others, counts.lost) == (60, 0, 0)
