"""`splitslam certs`: what it writes, how, and what it says when it cannot."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID
from typer.testing import CliRunner

from splitslam.errors import InputError
from splitslam.security import private_files
from splitslam.security.certificates import read_certificates
from splitslam.security.command import certs
from splitslam.security.tokens import TokenTable, hash_of


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    run("init", "--fleet", "farm.example", folder=tmp_path / "certs")
    return tmp_path / "certs"


def run(*arguments: str, folder: Path, code: int = 0) -> str:
    result = CliRunner().invoke(certs, [*arguments, "--folder", str(folder)])
    if isinstance(result.exception, InputError):
        raise result.exception
    assert result.exit_code == code, (result.output, result.exception)
    return result.output


def certificate(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def every_file(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def test_all_files_are_their_owners_alone(folder: Path) -> None:
    run("robot", "rover-1", "--site", "north", folder=folder)
    run("operator", "ann", folder=folder)
    run("service", "--host", "map.example", "--host", "10.0.0.1", folder=folder)
    run("envoy", "--host", "map.example", folder=folder)
    run("token", "rover-2", "--site", "north", folder=folder)
    run("revoke", str(folder / "robots/rover-1.pem"), folder=folder)
    run("renew", str(folder / "robots/rover-1.pem"), folder=folder)
    files = every_file(folder)
    assert len(files) == 12
    assert {stat.S_IMODE(path.stat().st_mode) for path in files} == {0o600}
    assert {stat.S_IMODE(path.stat().st_mode) for path in (folder, folder / "robots")} == {0o700}


def test_a_file_is_never_readable_by_others_nor_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "key"
    private_files.write_private(path, b"old")
    seen = []

    def no_disk(source: Path, target: Path) -> None:
        seen.append((source.read_bytes(), stat.S_IMODE(source.stat().st_mode)))
        raise OSError("no disk")

    monkeypatch.setattr(os, "replace", no_disk)
    before = os.umask(0)
    try:
        with pytest.raises(OSError, match="no disk"):
            private_files.write_private(path, b"new")
    finally:
        os.umask(before)
    assert seen == [(b"new", 0o600)]
    assert [p.name for p in tmp_path.iterdir()] == ["key"]
    assert path.read_bytes() == b"old"


def test_a_robots_certificate_is_for_calling_and_a_services_for_being_called(folder: Path) -> None:
    run("robot", "rover-1", "--site", "north", folder=folder)
    run("service", "--host", "map.example", "--host", "10.0.0.1", folder=folder)
    robot, service = certificate(folder / "robots/rover-1.pem"), certificate(folder / "service.pem")
    usage = {c: list(c.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value) for c in (robot, service)}
    assert usage == {robot: [ExtendedKeyUsageOID.CLIENT_AUTH], service: [ExtendedKeyUsageOID.SERVER_AUTH]}
    names = service.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["map.example"]
    assert [str(a) for a in names.get_values_for_type(x509.IPAddress)] == ["10.0.0.1"]
    assert not robot.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    authority = certificate(folder / "ca.pem")
    assert authority.extensions.get_extension_for_class(x509.BasicConstraints).value.path_length == 0
    robot.verify_directly_issued_by(authority)


def test_renewing_keeps_who_it_is_and_its_span_and_makes_a_new_key(folder: Path) -> None:
    run("service", "--host", "map.example", "--host", "10.0.0.1", "--days", "20", folder=folder)
    run("robot", "rover-1", "--site", "north", "--days", "300", folder=folder)
    old, old_key = certificate(folder / "service.pem"), (folder / "service.key").read_bytes()
    robot = (folder / "robots/rover-1.pem").read_bytes()
    said = run("renew", folder=folder)  # what expires within 30 days
    new = certificate(folder / "service.pem")
    assert "rover-1" not in said
    assert (folder / "robots/rover-1.pem").read_bytes() == robot
    assert (folder / "service.key").read_bytes() != old_key
    assert new.serial_number != old.serial_number
    for extension in (x509.SubjectAlternativeName, x509.ExtendedKeyUsage):
        assert new.extensions.get_extension_for_class(extension) == old.extensions.get_extension_for_class(extension)
    span = new.not_valid_after_utc - new.not_valid_before_utc
    assert abs((span - (old.not_valid_after_utc - old.not_valid_before_utc)).total_seconds()) < 2
    key = load_pem_private_key((folder / "service.key").read_bytes(), None)
    assert key.public_key() == new.public_key()


def test_a_second_certificate_takes_the_place_of_a_valid_one_only_by_force(folder: Path) -> None:
    """The first one would stay valid, unknown to this folder: nobody could revoke it any more."""
    rover, service = folder / "robots/rover-1.pem", folder / "service.pem"
    asked = (rover, ("robot", "rover-1", "--site", "north")), (service, ("service", "--host", "map.example"))
    for path, command in asked:
        run(*command, "--days", "20", folder=folder)
        first = path.read_bytes(), path.with_suffix(".key").read_bytes()
        said = rf"^{path}: is there already, valid until [-\d]{{10}} \(`splitslam certs renew {path}` renews it"
        with pytest.raises(InputError, match=said):
            run(*command, folder=folder)
        assert (path.read_bytes(), path.with_suffix(".key").read_bytes()) == first
        run(*command, "--force", folder=folder)
        assert path.read_bytes() != first[0]


def test_one_that_has_expired_or_is_revoked_makes_room(folder: Path) -> None:
    robot = ("robot", "rover-1", "--site", "north")
    run(*robot, folder=folder)
    run("revoke", str(folder / "robots/rover-1.pem"), folder=folder)
    run(*robot, "--days", "0", folder=folder)
    run(*robot, folder=folder)


def test_show_tells_what_expires_and_fails_when_it_is_soon(folder: Path) -> None:
    run("robot", "rover-1", "--site", "north", "--days", "10", folder=folder)
    lines = [json.loads(line) for line in run("show", "--json", "--within", "5", folder=folder).splitlines()]
    assert [line["identity"] for line in lines] == [None, "spiffe://farm.example/site/north/robot/rover-1"]
    assert "in 10 days" in run("show", folder=folder, code=1)


def test_a_name_is_one_robots_in_all_sites(folder: Path) -> None:
    run("robot", "rover-1", "--site", "north", folder=folder)
    run("token", "rover-2", "--site", "north", folder=folder)
    for command, name in (("robot", "rover-1"), ("token", "rover-1"), ("robot", "rover-2"), ("token", "rover-2")):
        with pytest.raises(InputError, match=r"expected another name, this one is spiffe://farm\.example/site/north/"):
            run(command, name, "--site", "south", folder=folder)
    run("operator", "rover-1", "--site", "south", folder=folder)


def test_a_token_is_shown_once_and_kept_as_its_hash(folder: Path) -> None:
    token = run("token", "rover-1", "--site", "north", folder=folder).strip()
    kept = (folder / "tokens.yaml").read_text()
    assert token not in kept
    assert hash_of(token) in kept
    table = TokenTable(folder / "tokens.yaml")
    owner = table.owner(token)
    assert owner is not None
    assert owner.uri == "spiffe://farm.example/site/north/robot/rover-1"
    assert table.owner(token[:-1]) is None
    (folder / "tokens.yaml").write_text("nonsense: x\n")
    assert table.owner(token) is None, "what cannot be read lets nobody in"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("init", "--fleet", "farm.example"), "expected no authority there"),
        (("init", "--fleet", "Farm"), "--fleet 'Farm': expected 1 to 63 of a-z"),
        (("robot", "a/b", "--site", "north"), "NAME 'a/b': expected 1 to 128 letters, digits"),
        (("robot", "rover-1", "--site", "up north"), "--site 'up north': expected 1 to 128 letters, digits"),
        (("token", "rover-1"), "a robot belongs to a site"),
        (("service", "--host", "map.example:50051"), "--host 'map.example:50051': expected a name or an address"),
        (("revoke", "nowhere.pem"), "nowhere.pem: cannot read"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(arguments: tuple[str, ...], text: str, folder: Path) -> None:
    with pytest.raises(InputError, match=text) as error:
        run(*arguments, folder=folder)
    assert "\n" not in str(error.value)


def test_the_authority_is_neither_renewed_nor_revoked(folder: Path) -> None:
    for command in ("renew", "revoke"):
        with pytest.raises(InputError, match="expected not the authority"):
            run(command, str(folder / "ca.pem"), folder=folder)


def test_a_certificate_of_another_authority_is_not_taken_for_ours(folder: Path, tmp_path: Path) -> None:
    run("init", "--fleet", "farm.example", folder=tmp_path / "other")
    run("robot", "rover-1", "--site", "north", folder=tmp_path / "other")
    with pytest.raises(InputError, match=r"expected a certificate of fleet farm\.example"):
        run("renew", str(tmp_path / "other/robots/rover-1.pem"), folder=folder)


def test_files_that_do_not_belong_together_are_named(folder: Path, tmp_path: Path) -> None:
    for name in ("rover-1", "rover-2"):
        run("robot", name, "--site", "north", folder=folder)
    cert, other, ca = folder / "robots/rover-1.pem", folder / "robots/rover-2.key", folder / "ca.pem"
    with pytest.raises(InputError, match=r"rover-2\.key: expected the key of .*rover-1\.pem"):
        read_certificates(cert, other, ca)
    with pytest.raises(InputError, match=r"ca\.pem: the certificate has|is not an identity"):
        read_certificates(ca, folder / "ca.key", ca)
    junk = tmp_path / "junk"
    junk.write_bytes(b"junk")
    with pytest.raises(InputError, match="junk: expected certificates in PEM"):
        read_certificates(cert, other, junk)
    with pytest.raises(InputError, match="junk: expected a private key in PEM"):
        read_certificates(cert, junk, ca)
