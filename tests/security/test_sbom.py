"""The bill of materials is that of the lock, in a form that others' tools read."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

from tests.conftest import ROOT

LOCKED = re.compile(r"^([A-Za-z0-9._-]+)==(\S+)", re.MULTILINE)


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_every_locked_package_is_in_the_bill_of_materials_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "sbom.json"
    made = subprocess.run(["make", "sbom", f"SBOM={path}"], cwd=ROOT, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    text = path.read_text()
    validator = JsonStrictValidator(SchemaVersion.V1_6)
    assert validator.validate_str(text) is None
    bill = json.loads(text)
    assert bill["metadata"]["component"]["name"] == "splitslam"
    listed = {canonical(c["name"]): c["version"] for c in bill["components"]}
    locked = {canonical(n): v for n, v in LOCKED.findall((ROOT / "requirements/lock.txt").read_text())}
    assert listed == locked
    assert len(locked) > 50
    assert all(c["purl"].startswith("pkg:pypi/") for c in bill["components"])
    assert validator.validate_str(text.replace('"CycloneDX"', '"Something"')) is not None, "it takes anything"
