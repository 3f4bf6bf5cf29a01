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
