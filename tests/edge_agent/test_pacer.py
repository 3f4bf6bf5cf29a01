from __future__ import annotations

import numpy as np

from edge_agent.pacer import Pacer


def test_a_backlog_leaves_as_fast_as_the_limit_allows_and_no_faster():
    pacer, now_s, sent = Pacer(), 100.0, []
    for size in np.random.default_rng(0).integers(300, 9000, 400).tolist():
        while (wait_s := pacer.wait_s(now_s, size, 200)) > 0:
            now_s += wait_s
        pacer.sent(now_s, size)
        sent.append((now_s, size))
    times, sizes = np.array(sent).T
    windows = [sizes[(times >= t) & (times < t + 5)].sum() for t in times[times < times[-1] - 5]]
    assert max(windows) <= 1.10 * 200 * 125 * 5
    assert sizes.sum() / (times[-1] - times[0] + 5) > 0.9 * 200 * 125


def test_without_a_limit_nothing_waits():
    pacer = Pacer()
    for _ in range(100):
        assert pacer.wait_s(0.0, 10**6, None) == 0
        pacer.sent(0.0, 10**6)


def test_a_message_larger_than_the_limit_goes_alone():
    pacer = Pacer()
    assert pacer.wait_s(0.0, 10**6, 10) == 0
    pacer.sent(0.0, 10**6)
    assert 4.8 < pacer.wait_s(0.1, 100, 10) < 5.0


Sent = list[tuple[float, int]]


def sent_beside(live: Sent, limit_kbps: float, until_s: float) -> Sent:
    """What goes besides `live` messages (time, bytes) when there is always something of 1,000 bytes to send."""
    pacer, spare = Pacer(), []
    now_s, todo = 0.0, list(live)
    while now_s < until_s:
        while todo and todo[0][0] <= now_s:
            pacer.sent(*todo.pop(0))
        if pacer.spare_s(now_s, 1000, limit_kbps, live=True) == 0:
            pacer.sent(now_s, 1000, live=False)
            spare.append((now_s, 1000))
        else:
            now_s += 0.02
    return spare


def largest_window(sent: Sent) -> int:
    times, sizes = np.array(sorted(sent)).T
    return int(max(sizes[(times >= t) & (times < t + 5)].sum() for t in times))


def test_what_is_not_live_takes_what_live_frames_leave_and_the_limit_holds():
    live = [(0.1 * i, 1000 if i % 10 else 6000) for i in range(1, 600)]  # 15 kB/s
    spare = sent_beside(live, 200, 60.0)
    assert largest_window(live + spare) <= 200 * 125 * 5
    left = 0.95 * 200 * 125 * 5 - largest_window(live)
    assert sum(size for _, size in spare) / 60 > 0.9 * left / 5


def test_a_live_message_never_waits_for_what_is_not_live():
    live = [(0.1 * i, 2000) for i in range(1, 300)]
    spare = sent_beside(live, 200, 30.0)
    pacer, todo = Pacer(), sorted([(t, size, True) for t, size in live] + [(t, size, False) for t, size in spare])
    for now_s, size, is_live in todo:
        if is_live:
            assert pacer.wait_s(now_s, size, 200) == 0
        pacer.sent(now_s, size, live=is_live)


def test_a_robot_that_stood_for_a_moment_finds_its_room_when_it_goes_on():
    moving = [(0.1 * i, 2000) for i in range(1, 100)]
    standing = [(10 + 0.1 * i, 100) for i in range(1, 200)]
    spare = sent_beside(moving + standing, 200, 30.0)
    again = [(30 + 0.1 * i, 2000) for i in range(1, 50)]
    assert largest_window(spare + standing + again) <= 200 * 125 * 5


def test_without_live_messages_all_of_the_limit_is_to_spare():
    pacer = Pacer()
    for i in range(50):
        pacer.sent(0.1 * i, 2400)
    assert pacer.spare_s(11.0, 100_000, 200, live=True) > 0
    assert pacer.spare_s(11.0, 100_000, 200, live=False) == 0
