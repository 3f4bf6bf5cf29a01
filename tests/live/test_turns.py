"""A Velodyne's packets become turns, whatever the network does to them on the way."""

from __future__ import annotations

import random
from collections import Counter
from itertools import pairwise

import pytest

from edge_agent.sources.live.turns import HOUR_NS, Packet, Turns, unwrapped
from tests.live.made import STEP_US, data_packet

T0_NS = 1_700_000_000 * 10**9 // HOUR_NS * HOUR_NS  # a full hour
WHOLE = range(30, 310)  # three whole turns and pieces at both ends


def cut(numbers: list[int], start_us: float = 1e6) -> tuple[list[list[Packet]], Counter[str]]:
    """The turns of these packets, in this order, and the counts; the last one is flushed."""
    turns = Turns("vlp16", 10.0, Counter())
    near_ns = T0_NS + round(start_us * 1000)
    found = [turn for number in numbers for turn in turns.add(data_packet(number, start_us), near_ns)]
    return found + turns.flush(), turns.counts


def numbers_of(turn: list[Packet], start_us: float = 1e6) -> list[int]:
    return [round(((packet.sensor_ns - T0_NS) / 1000 - start_us) / STEP_US) for packet in turn]


def test_a_turn_begins_where_the_azimuth_wraps_and_every_packet_is_in_one():
    turns, counts = cut(list(WHOLE))
    assert [(numbers_of(turn)[0], len(turn)) for turn in turns] == [(76, 75), (151, 76), (227, 75), (302, 8)]
    assert counts == {"start": 46, "used": 234, "lost": 0}
    assert [number for turn in turns for number in numbers_of(turn)] == list(range(76, 310))


@pytest.mark.parametrize("seed", range(5))
def test_lost_packets_are_counted_and_the_turn_goes_on_with_what_it_has(seed: int):
    kept = [number for number in WHOLE if random.Random(seed * 1000 + number).random() > 0.2]
    turns, counts = cut(kept)
    assert [number for turn in turns for number in numbers_of(turn)] == [n for n in kept if n >= 76]
    assert counts["lost"] == kept[-1] - kept[0] + 1 - len(kept)
    assert counts["start"] + counts["used"] == len(kept)


def test_a_sensor_that_stands_still_ends_its_turns_all_the_same_and_nothing_piles_up():
    turns, most = Turns("vlp16", 10.0, Counter()), 0
    still = data_packet(30)
    found: list[list[Packet]] = []
    for number in range(10_000):
        packet = still[:1200] + data_packet(number, 1e6)[1200:]
        found += turns.add(packet, T0_NS + 10**9)
        most = max(most, len(turns._packets))
    assert most < 2_000
    assert not found
    assert turns.counts["start"] > 8_000
    for number in range(10_000, 10_400):
        found += turns.add(data_packet(number, 1e6), T0_NS + 10**9)
    assert [len(turn) for turn in found[1:]] == [75, 76, 75]


@pytest.mark.parametrize("at", [100, 149, 150, 151, 226])
def test_packets_that_change_places_are_put_in_order_across_the_wrap_too(at: int):
    numbers = list(WHOLE)
    place = numbers.index(at)
    numbers[place], numbers[place + 1] = numbers[place + 1], numbers[place]
    turns, counts = cut(numbers)
    assert [numbers_of(turn) for turn in turns] == [numbers_of(turn) for turn in cut(list(WHOLE))[0]]
    assert counts["reordered"] == 1
    assert counts["lost"] == 0


def test_a_packet_that_comes_when_its_turn_is_gone_is_counted_as_late_and_as_lost():
    numbers = list(WHOLE)
    numbers.remove(149)
    numbers.insert(numbers.index(160), 149)
    turns, counts = cut(numbers)
    assert counts["late"] == 1
    assert counts["lost"] == 1
    assert 149 not in numbers_of(turns[0])


@pytest.mark.parametrize("after", [0, 1, 2])
def test_a_packet_that_comes_twice_is_taken_once(after: int):
    numbers = list(WHOLE)
    numbers.insert(numbers.index(151) + after, 150)
    turns, counts = cut(numbers)
    assert counts["duplicate"] == 1
    assert sum(map(len, turns)) == 234


def test_time_goes_on_over_the_full_hour():
    start_us = 3_600_000_000 - 200_000.0
    turns, counts = cut(list(WHOLE), start_us)
    stamps_ns = [packet.sensor_ns for turn in turns for packet in turn]
    assert all(1_327_000 <= b - a <= 1_328_000 for a, b in pairwise(stamps_ns))
    assert stamps_ns[0] < T0_NS + HOUR_NS < stamps_ns[-1]
    assert counts["lost"] == 0


def test_a_packet_of_before_the_full_hour_that_comes_after_it_is_put_before_it():
    start_us = 3_600_000_000 - 110 * STEP_US
    numbers = list(WHOLE)
    place = numbers.index(109)
    numbers[place], numbers[place + 1] = numbers[place + 1], numbers[place]
    turns, counts = cut(numbers, start_us)
    assert numbers_of(turns[0], start_us) == list(range(76, 151))
    assert counts["reordered"] == 1


@pytest.mark.parametrize("gone", [(120, 170), (100, 210), (140, 300)])
def test_no_turn_spans_two_when_a_wrap_was_lost(gone: tuple[int, int]):
    turns, counts = cut([number for number in WHOLE if not gone[0] <= number < gone[1]])
    assert all(turn[-1].sensor_ns - turn[0].sensor_ns < 100_000_000 for turn in turns)
    assert counts["lost"] == gone[1] - gone[0]


def test_after_a_silence_the_first_piece_of_a_turn_is_left_out_as_at_the_start():
    turns, counts = cut([*range(30, 130), *range(1000, 1240)])
    assert numbers_of(turns[0]) == list(range(76, 130))
    assert numbers_of(turns[1])[0] == 1056  # the next wrap
    assert counts["start"] == 46 + 56
    assert counts["lost"] == 0  # the sensor was away, which is counted elsewhere


def test_a_clock_that_steps_begins_anew_instead_of_calling_everything_late():
    turns = Turns("vlp16", 10.0, Counter())
    found = [turn for n in WHOLE for turn in turns.add(data_packet(n, 1e9), T0_NS)]
    found += [turn for n in range(310, 500) for turn in turns.add(data_packet(n, 5e8), T0_NS)]
    assert turns.counts["late"] == 0
    assert sum(map(len, found)) + turns.counts["start"] > 420


@pytest.mark.parametrize("near_ns", [0, T0_NS, T0_NS + HOUR_NS // 2 - 1, T0_NS - HOUR_NS // 2 + 1])
def test_the_hour_is_the_nearest(near_ns: int):
    for since_hour_ns in (0, 1, HOUR_NS // 2, HOUR_NS - 1):
        found = unwrapped(since_hour_ns, near_ns)
        assert found % HOUR_NS == since_hour_ns
        assert abs(found - near_ns) <= HOUR_NS // 2
