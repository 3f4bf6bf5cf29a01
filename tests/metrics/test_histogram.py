from __future__ import annotations

import threading

from prometheus_client import CollectorRegistry, Histogram, generate_latest

from splitslam.metrics import Family
from splitslam.metrics.definition import Label, histogram
from splitslam.metrics.histogram import Observed

STAGES = histogram("edge_seconds", "Times", "", (0.001, 0.5, 2.0), Label("stage", ("encode", "motion")))
VALUES = (0.0, 0.001, 0.0011, 0.5, 1.9, 2.0, 7.0, 1e9)  # on bounds, between them and beyond


def test_a_histogram_is_shown_as_prometheus_client_shows_its_own():
    ours, theirs = CollectorRegistry(), CollectorRegistry()
    family = Family(STAGES, ours)
    twin = Histogram(STAGES.name, STAGES.text, STAGES.label_names, buckets=STAGES.buckets, registry=theirs)
    for stage in ("encode", "motion"):
        twin.labels(stage)
    assert generate_latest(ours) == generate_latest(theirs)  # all series are there, with nothing in them
    for value in VALUES:
        family.observe(value, "motion")
        twin.labels("motion").observe(value)
    assert generate_latest(ours) == generate_latest(theirs)
    family.observe(3.0, "encode")
    assert generate_latest(ours) == generate_latest(ours) != generate_latest(theirs)


def test_what_waits_to_be_added_up_is_bounded_and_nothing_of_it_is_lost():
    observed = Observed((1.0,))
    for _ in range(25_000):
        observed.observe(0.5)
    assert len(observed._waiting) <= 10_001
    assert observed.totals() == ([25_000, 25_000], 12_500.0)


def test_threads_that_observe_while_others_ask_lose_nothing():
    observed = Observed((1.0,))

    def observe() -> None:
        for _ in range(20_000):
            observed.observe(2.0)

    threads = [threading.Thread(target=observe) for _ in range(3)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        observed.totals()
    assert observed.totals() == ([0, 60_000], 120_000.0)
