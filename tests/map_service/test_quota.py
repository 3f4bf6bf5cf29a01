"""A site at its quota is refused and loses nothing."""

from __future__ import annotations

import time
from collections.abc import Callable

from map_service.catalog import Catalog
from map_service.store import Store
from splitslam.wire import session_pb2 as pb
from tests.map_service.harness import WAIT_S, Robot7, Service, frame, new_run

RETRY_S = 7.0
MANY = 300  # frames; at 200 bytes each far beyond the quota


def test_a_site_at_its_quota_is_refused_in_the_run_and_at_hello_and_all_that_was_answered_is_kept(
    start_service: Callable[..., Service], connect: Callable[..., Robot7], session_id: str
) -> None:
    service = start_service(
        quota={"site_bytes": 4000, "sites": {"rich": 0}, "every_s": 0.1, "retry_after_s": RETRY_S},
        housekeeping_s=0.1,
    )
    robot = connect(service, site_id="poor")
    seq = 0
    while (response := robot.inbox.get(timeout=WAIT_S)) is not None and not response.HasField("refused"):
        assert seq < MANY, "never refused"
        if response.HasField("welcome") or response.HasField("odometry"):
            seq += 1
            time.sleep(0.02)
            robot.send(frame(seq))
    assert response is not None
    assert response.refused.reason == pb.REFUSED_REASON_QUOTA
    assert response.refused.retry_after_ms == RETRY_S * 1e3
    assert "'poor'" in response.refused.detail
    again = connect(service, site_id="poor").next("refused")
    assert (again.reason, again.retry_after_ms) == (pb.REFUSED_REASON_QUOTA, RETRY_S * 1e3)
    store = Store(service.store_url)
    row = Catalog(store).session(session_id)
    assert row is not None
    assert row.last_seq >= seq - 1, "the last one sent may never have been answered"
    assert row.bytes >= 4000
    other = connect(service, site_id="rich", run_id=new_run())
    assert other.ask(frame(1)).seq == 1
    assert '"reason": "quota"' in service.log
    refused = 'splitslam_map_refused_total{reason="quota"}'
    metrics = service.wait_metrics(lambda page: page.get(refused, 0) >= 2, "both refusals counted")
    assert metrics[refused] == 2
    assert metrics['splitslam_map_store_bytes{site="other"}'] >= 4000
    assert metrics["splitslam_map_database_bytes"] > metrics['splitslam_map_store_bytes{site="other"}']
    assert Catalog(store).delete(session_id) is not None
    store.close()
    assert connect(service, site_id="poor").next("welcome").durable_seq == 0
