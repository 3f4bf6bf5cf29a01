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
    live = [(0.1 * i, 1000 if i % 10 else 6000) for i in range(1, 1200)]  # 15 kB/s
    spare = sent_beside(live, 200, 120.0)
    assert largest_window(live + spare) <= 200 * 125 * 5
    left = 0.95 * 200 * 125 * 5 - largest_window(live)
    assert min(spare)[0] > 60.0, "before it was known what live frames need"
    assert sum(size for _, size in spare) / 60 > 0.9 * left / 5


def test_a_live_message_never_waits_for_what_is_not_live():
    live = [(0.1 * i, 2000) for i in range(1, 900)]
    spare = sent_beside(live, 200, 90.0)
    pacer = Pacer()
    for now_s, size, is_live in sorted([(*sent, True) for sent in live] + [(*sent, False) for sent in spare]):
        if is_live:
            assert pacer.wait_s(now_s, size, 200) == 0
        pacer.sent(now_s, size, live=is_live)
    assert spare


def test_a_robot_that_stood_for_minutes_finds_its_room_when_it_goes_on():
    moving = [(0.1 * i, 2000) for i in range(1, 100)]
    standing = [(10 + 0.1 * i, 100) for i in range(1, 2900)]
    spare = sent_beside(moving + standing, 200, 300.0)
    again = [(300 + 0.1 * i, 2000) for i in range(1, 50)]
    assert largest_window(spare + standing + again) <= 200 * 125 * 5
    assert sum(size for _, size in spare) > 240 * 2000


def test_without_live_messages_all_of_the_limit_is_to_spare():
    pacer = Pacer()
    for i in range(700):
        pacer.sent(0.1 * i, 2400)
    assert pacer.spare_s(76.0, 100_000, 200, live=True) > 0
    assert pacer.spare_s(76.0, 100_000, 200, live=False) == 0
