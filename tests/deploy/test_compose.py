"""docker-compose.yml sets only what the map service's configuration knows."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from map_service.config import ENV_PREFIX, ServiceConfig
from splitslam.config import load
from tests.conftest import ROOT

COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
SERVICE = COMPOSE["services"]["map_service"]


def test_the_environment_of_the_service_is_a_valid_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    for key, value in SERVICE["environment"].items():
        assert key.startswith(f"{ENV_PREFIX}__")
        monkeypatch.setenv(key, value)
    config = load(ServiceConfig, None, env_prefix=ENV_PREFIX)
    published = {mapping.partition(":")[2] for mapping in SERVICE["ports"]}
    assert published == {config.listen.rpartition(":")[2], str(config.metrics.port)}


def test_the_store_lies_on_the_volume_and_the_image_has_a_recipe() -> None:
    (volume,) = SERVICE["volumes"]
    name, _, folder = volume.partition(":")
    assert name in COMPOSE["volumes"]
    assert SERVICE["environment"]["SPLITSLAM_MAP__STORE"].startswith(f"sqlite:///{folder}/")
    recipe = ROOT / SERVICE["build"]["context"] / SERVICE["build"]["dockerfile"]
    copied = [line.split()[1:-1] for line in recipe.read_text().splitlines() if line.startswith("COPY ")]
    missing = [source for sources in copied for source in sources if not Path(ROOT, source).exists()]
    assert not missing
