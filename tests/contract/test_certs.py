"""The radio's certificates and everything that can be wrong with them or with the two hosts: one clear line each."""

import re
import socket
import stat

import pytest
from cryptography import x509
from typer.testing import CliRunner

from services.config import ConfigError, load
from services.console import install
from services.console.cli import app
from services.console.start import bus_config
from services.gateway import certs
from services.gateway.certs import CertsError
from services.gateway.start import console_bus, gateway_bus

HERE = "127.0.0.1"
ELSEWHERE = "203.0.113.7"  # reserved for documentation: nobody's


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("CLEW_CERTS_DIR", str(tmp_path / "certs"))
    certs.init(tmp_path / "certs")
    return tmp_path / "certs"


def profile(tmp_path, host: str, address: str = HERE, extra: str = "", names: str = "drone:drone ground:ground"):
    file = tmp_path / "profile.toml"
    file.write_text(
        f'base = "two_hosts"\n[system]\nhost = "{host}"\n[radio]\naddress = "{address}"\nconsole = "desk"\n'
        f"names = {names.split()}\n{extra}"
    )
    return load(str(file))


def fault(tmp_path, host: str, **how: str) -> str:
    """What `clew up` would say."""
    config = profile(tmp_path, host, **how)
    start = console_bus if host == "console" else gateway_bus
    with pytest.raises(ConfigError) as caught:
        start(config, bus_config(config))
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_a_certificate_says_who_what_where_and_is_signed(folder):
    certs.issue(folder, "base", "ground", [HERE, "base.lan"])
    made = x509.load_pem_x509_certificate((folder / "base.pem").read_bytes())
    made.verify_directly_issued_by(x509.load_pem_x509_certificate((folder / "ca.pem").read_bytes()))
    assert made.subject.rfc4514_string() == "CN=ground:base"
    sans = made.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert [str(name.value) for name in sans] == [HERE, "base.lan", "base"]
    certs.credentials(folder, "base", "ground", HERE)


def test_keys_are_for_their_owner_only(folder):
    certs.issue(folder, "base", "ground")
    for name in ("ca.key", "base.key"):
        assert stat.S_IMODE((folder / name).stat().st_mode) == 0o600


def test_nothing_is_overwritten_and_roles_and_names_are_checked(folder):
    certs.issue(folder, "base", "ground")
    for name, role, why in (
        ("base", "ground", "exists already"),
        ("x", "pilot", "role 'pilot': must be one of drone, ground, operator, viewer"),
        ("../x", "drone", "letters, digits"),
        ("ca", "drone", "not ca"),
    ):
        with pytest.raises(CertsError, match=re.escape(why)):
            certs.issue(folder, name, role)
    with pytest.raises(CertsError, match="would be shut out"):
        certs.init(folder)


def test_the_command_line_tells_all_of_it(folder):
    run = CliRunner().invoke
    assert run(app, ["certs", "issue", "base", "--role", "ground", "--address", HERE]).exit_code == 0
    assert run(app, ["certs", "issue", "base", "--role", "ground"]).exit_code == 2
    shown = run(app, ["certs", "show"])
    assert shown.exit_code == 0
    assert all(word in shown.stdout for word in ("authority", "base", "ground", HERE, "good"))
    certs.issue(folder, "late", "viewer", days=-1)
    shown = run(app, ["certs", "show"])
    assert shown.exit_code == 1
    assert "expired" in shown.stdout


def test_a_missing_key_or_certificate(folder, tmp_path):
    assert fault(tmp_path, "ground") == (
        f"{folder}/ground.pem: is missing: clew certs issue ground --role ground makes it, where ca.key is"
    )
    certs.issue(folder, "ground", "ground", [HERE])
    (folder / "ground.key").unlink()
    assert "ground.key: is missing" in fault(tmp_path, "ground")


def test_files_that_are_not_what_they_are_called(folder, tmp_path):
    certs.issue(folder, "ground", "ground", [HERE])
    for name, why in (("ground.key", "is no key, or one with a password"), ("ground.pem", "is no certificate")):
        good = (folder / name).read_bytes()
        (folder / name).write_text("junk\n")
        assert fault(tmp_path, "ground") == f"{folder / name}: {why}"
        (folder / name).write_bytes(good)
    (folder / "ca.pem").unlink()
    assert (
        fault(tmp_path, "ground")
        == f"{folder}/ca.pem: is missing: copy it from the one machine where clew certs init made it"
    )


def test_a_key_that_others_can_read(folder, tmp_path):
    certs.issue(folder, "ground", "ground", [HERE])
    (folder / "ground.key").chmod(0o644)
    assert fault(tmp_path, "ground") == f"{folder}/ground.key: mode 644: must be 600, others can read it"


def test_a_key_of_another_user(folder, tmp_path, monkeypatch):
    """As root made it on the host of a service that is not root."""

    def refused(_: object):
        raise PermissionError

    certs.issue(folder, "ground", "ground", [HERE])
    monkeypatch.setattr(type(folder), "read_bytes", refused)
    text = fault(tmp_path, "ground")
    assert re.fullmatch(rf"{folder}/ground.pem: belongs to \S+: this user cannot read it", text)


def test_a_certificate_for_another_host(folder, tmp_path):
    certs.issue(folder, "ground", "ground", ["10.0.0.9"])
    expected = f"{folder}/ground.pem: is for 10.0.0.9, ground, but radio.address = {HERE}"
    assert fault(tmp_path, "ground") == expected


def test_a_certificate_of_another_role_authority_or_time(folder, tmp_path):
    certs.issue(folder, "ground", "viewer", [HERE])
    assert "is made out to viewer:ground, this profile needs ground:ground" in fault(tmp_path, "ground")
    for file in folder.glob("ground.*"):
        file.unlink()
    certs.issue(folder, "ground", "ground", [HERE], days=-1)
    assert "expired on" in fault(tmp_path, "ground")
    for file in folder.glob("*"):
        if file.name != "ca.pem":
            file.unlink()
    ca = (folder / "ca.pem").read_bytes()
    (folder / "ca.pem").unlink()
    certs.init(folder)
    certs.issue(folder, "ground", "ground", [HERE])
    (folder / "ca.pem").write_bytes(ca)
    assert "was not issued by the authority" in fault(tmp_path, "ground")


def test_a_key_of_another_certificate(folder, tmp_path):
    certs.issue(folder, "ground", "ground", [HERE])
    certs.issue(folder, "drone", "drone")
    (folder / "ground.key").write_bytes((folder / "drone.key").read_bytes())
    assert "does not belong to" in fault(tmp_path, "ground")


def test_an_address_that_does_not_resolve_or_is_not_this_machine(folder, tmp_path, monkeypatch):
    def nowhere(*_: object, **__: object):
        raise socket.gaierror(-2, "Name or service not known")

    certs.issue(folder, "ground", "ground", [ELSEWHERE])
    assert fault(tmp_path, "ground", address=ELSEWHERE).endswith("is no address of this machine, the ground station")
    monkeypatch.setattr(socket, "getaddrinfo", nowhere)
    assert fault(tmp_path, "drone", address="nowhere") == (
        "radio.address = nowhere: does not resolve: Name or service not known"
    )


def test_both_hosts_are_the_drone(folder, tmp_path):
    certs.issue(folder, "drone", "drone")
    expected = f"radio.address = {HERE}: is this machine's own, but system.host = drone"
    assert fault(tmp_path, "drone") == expected


def test_names_of_the_profile(folder, tmp_path):
    both = "drone:a drone:b ground:ground"
    assert fault(tmp_path, "drone", address=ELSEWHERE, names=both) == "radio.names: 2 names of role drone: must be one"
    assert "radio.console = 'desk': must be an operator or a viewer" in fault(tmp_path, "console")


@pytest.mark.parametrize(
    ("extra", "why"),
    [
        ('[hosts.drone]\nservices = ["px4_bridge"]\n', "hosts.drone.services: must contain drone_gateway"),
        (
            '[hosts.drone]\nservices = ["drone_gateway", "tracker"]\n',
            "hosts.drone.services: tracker runs twice, must be on one host and once",
        ),
        (
            '[hosts.drone]\nservices = ["drone_gateway", "pilot"]\n',
            "hosts.drone.services: pilot: must be one of tracker",
        ),
        ("[hosts.moon]\nservices = []\n", "hosts = drone, ground, moon: must be drone and ground"),
    ],
)
def test_hosts_that_do_not_fit_together(tmp_path, extra, why):
    with pytest.raises(ConfigError, match=re.escape(why)):
        profile(tmp_path, "drone", extra=extra)


def test_installing_plans_every_service_of_the_host_and_nothing_of_the_other(tmp_path, monkeypatch):
    for host in ("drone", "ground"):
        config = load(host)
        made = install.plan(host, config)
        enabled = next(command for command in made.commands if "enable" in command)
        assert enabled[3:] == [f"clew@{name}.service" for name in config.system.services]
        assert any("udev" in str(path) for path in made.files) is (host == "drone")
        assert install.install(host, dry_run=False, root=tmp_path / host) == 0
        assert (tmp_path / host / "etc/clew/host.env").read_text() == f"CLEW_PROFILE={host}\n"
    own = tmp_path / "own.toml"
    own.write_text('base = "drone"\n')
    monkeypatch.chdir(tmp_path)
    assert install.plan("own.toml", load("own.toml")).files[install.ETC / "host.env"][1] == f"CLEW_PROFILE={own}\n"
    fifo = tmp_path / "drone/etc/systemd/system/clew@px4_bridge.service.d/onboard.conf"
    assert "CPUSchedulingPolicy=fifo" in fifo.read_text()
    assert install.install("demo", dry_run=True) == 2


def test_a_name_without_a_role(tmp_path):
    with pytest.raises(ConfigError, match=r"radio.names: 'anna': must be role:name, with a role of drone, ground"):
        profile(tmp_path, "drone", names="anna")
