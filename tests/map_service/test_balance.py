"""Replicas share robots fairly: who moves one, when, where to; and who counts as alive."""

from __future__ import annotations

import random
import threading
import time
from pathlib import Path

import pytest

from map_service.config import ReplicaConfig
from map_service.membership import Membership, Peer, Peers, own_address
from map_service.rebalance import Balance
from map_service.store import Store

CONFIG = ReplicaConfig()


def peers(own: int, *sessions: int) -> Peers:
    alive = tuple(Peer(n, str(i), f"10.0.0.{i}:50051") for i, n in enumerate(sessions))
    return Peers(str(own), alive)


def test_rooms_fill_up_the_emptiest_first_and_never_the_own_one() -> None:
    assert peers(0, 9, 0, 2).rooms(4) == ["10.0.0.1:50051"] * 2 + ["10.0.0.1:50051", "10.0.0.2:50051"]
    assert peers(0, 9).rooms(3) == []
    assert Peers("0").rooms(3) == []


def looks_until_a_move(view: Peers, period_s: float = 1.0, most: int = 50) -> int | None:
    balance = Balance(CONFIG)
    return next((look for look in range(1, most) if balance.look(view, look * period_s)), None)


def test_only_one_of_the_fullest_moves_and_only_after_a_dead_replica_would_have_gone() -> None:
    assert looks_until_a_move(peers(0, 2, 2, 0)) is None
    assert looks_until_a_move(peers(1, 2, 2, 0)) == CONFIG.lost_beats + 1


def test_loads_that_differ_by_one_stay_for_ever() -> None:
    assert [looks_until_a_move(peers(own, 2, 1, 2)) for own in range(3)] == [None] * 3


@pytest.mark.parametrize("loads", [[4, 4, 0], [12, 0], [5, 5, 5, 0, 0], [9, 1, 1, 1], [1, 0, 0]])
@pytest.mark.parametrize("seed", range(5))
def test_replicas_that_see_each_other_late_come_to_rest_without_needless_moves(loads: list[int], seed: int) -> None:
    """Each looks once a second at its own time; a move takes 0.3 s, and the table shows loads of up to a second ago."""
    rng = random.Random(seed)
    loads, count = list(loads), len(loads)
    balances = [Balance(CONFIG) for _ in loads]
    shown = list(loads)
    phase = [rng.random() for _ in loads]
    on_the_way: list[tuple[float, int]] = []
    needed = sum(max(0, n - -(-sum(loads) // count)) for n in loads)
    moves, last_s = 0, 0.0
    events = sorted((k + phase[i], i) for k in range(120) for i in range(count))
    for now_s, i in events:
        for due_s, target in [m for m in on_the_way if m[0] <= now_s]:
            loads[target] += 1
            on_the_way.remove((due_s, target))
        shown[i] = loads[i]
        view = peers(i, *shown)
        if balances[i].look(view, now_s):
            (address,) = view.rooms(1)
            loads[i] -= 1
            on_the_way.append((now_s + 0.3, int(address.removeprefix("10.0.0.").partition(":")[0])))
            moves, last_s = moves + 1, now_s
    assert max(loads) - min(loads) <= 1
    assert moves <= needed + 2
    assert last_s < 60


def membership(store: Store, sessions: int) -> Membership:
    config = ReplicaConfig(beat_s=0.05, lost_beats=3)
    return Membership(store, config, f"10.0.0.{sessions}:50051", lambda: sessions)


def wait_for(done, timeout_s: float = 30.0) -> None:
    deadline_s = time.monotonic() + timeout_s
    while not done():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def test_replicas_see_each_other_and_one_that_is_silent_is_gone(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path}/map.db")
    one, two = membership(store, 1), membership(store, 2)
    one.start()
    two.start()
    wait_for(lambda: [sorted(peer.sessions for peer in m.peers.alive) for m in (one, two)] == [[1, 2], [1, 2]])
    two._stop.set()  # as SIGKILL would: the row stays
    wait_for(lambda: [peer.sessions for peer in one.peers.alive] == [1])
    late = membership(store, 3)
    late.start()
    wait_for(lambda: late.looks > 10)
    assert 2 not in {peer.sessions for peer in late.peers.alive}, "the dead row never counted"
    wait_for(lambda: sorted(peer.sessions for peer in late.peers.alive) == [1, 3])
    one.leave(5.0)
    wait_for(lambda: [peer.sessions for peer in late.peers.alive] == [3])
    late.leave(5.0)
    store.close()


def test_nobody_is_sent_to_a_replica_whose_workers_have_died_until_one_is_back(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path}/map.db")
    config, ready = ReplicaConfig(beat_s=0.05, lost_beats=3), threading.Event()
    ready.set()
    one = membership(store, 1)
    two = Membership(store, config, "10.0.0.2:50051", lambda: 2, ready.is_set)
    one.start()
    two.start()
    wait_for(lambda: one.peers.rooms(1) == ["10.0.0.2:50051"])
    ready.clear()
    wait_for(lambda: one.peers.rooms(1) == [])
    wait_for(lambda: two.peers.rooms(1) == ["10.0.0.1:50051"])  # it still knows where its own robots could go
    ready.set()
    wait_for(lambda: one.peers.rooms(1) == ["10.0.0.2:50051"])
    one.leave(5.0)
    two.leave(5.0)
    store.close()


def test_the_address_is_the_configured_one_or_where_it_listens_as_others_see_it() -> None:
    assert own_address(ReplicaConfig(address="rack-2:50051"), "0.0.0.0:50051") == "rack-2:50051"
    assert own_address(CONFIG, "127.0.0.1:4711") == "127.0.0.1:4711"
    host, _, port = own_address(CONFIG, "0.0.0.0:50051").rpartition(":")
    assert host not in ("", "0.0.0.0")
    assert port == "50051"


def test_a_replica_that_shares_its_store_with_nobody_leaves_without_a_word(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path}/map.db")
    membership(store, 1).leave(5.0)
    assert not any(thread.name == "membership-leave" for thread in threading.enumerate())
    store.close()
