"""A map service of this machine: its configuration, its store, its metrics."""

from __future__ import annotations

from pathlib import Path

import yaml

from splitslam import config as configuration
from splitslam.diagnose import checks
from splitslam.diagnose.agent import fetch_metrics
from splitslam.diagnose.bundle import Bundle
from splitslam.diagnose.checks import Check, Verdict

_STORE_S = 3.0


def learn_and_collect(file: Path, bundle: Bundle, name: str) -> list[Check]:
    """Fills the folder `name` of the bundle. Raises InputError for a file that cannot be used."""
    from map_service.config import ENV_PREFIX, ServiceConfig
    from map_service.store import Store
    from splitslam.errors import InputError

    bundle.redactor.mapping(configuration.parse_yaml(configuration.read_text(file), str(file)))
    config = configuration.load(ServiceConfig, file, ENV_PREFIX)
    clean = bundle.redactor.mapping(config.model_dump(mode="json"))
    text = yaml.safe_dump(clean, sort_keys=False, default_flow_style=None, width=120)
    bundle.text(f"{name}/configuration/effective.yaml", text)
    try:
        Store(config.store, _STORE_S).close()
        store = Check("store", Verdict.OK, bundle.redactor.text(f"{config.store}: answers"))
    except InputError as error:
        store = Check("store", Verdict.FAIL, bundle.redactor.text(str(error)))
    port = config.listen.rpartition(":")[2]
    found = [store, checks.reachable("map service", "127.0.0.1", int(port))]
    if config.metrics.port:
        found += fetch_metrics(f"http://{config.metrics.host}:{config.metrics.port}/metrics", bundle, name)
    return found
