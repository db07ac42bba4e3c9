"""`clew install drone|ground`: a host that starts its services at boot. It plans first, so that it can be looked at.

The plan is files to write and commands to run; `apply` needs root, `--dry-run` prints. What it does not do: make
certificates (clew certs), copy them, or set the clock (deploy/chrony).
"""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from services.config import Config, ConfigError, load
from services.profile_file import deploy_folder

ONBOARD = ("px4_bridge", "force_estimator", "safety_supervisor")
"""Whose loops go before everything else: they hold the person's hand."""
SYSTEMD, UDEV, ETC = Path("etc/systemd/system"), Path("etc/udev/rules.d"), Path("etc/clew")


@dataclass(frozen=True)
class Plan:
    """Files by their place under the root, with mode and text; then commands."""

    files: dict[Path, tuple[int, str]]
    commands: list[list[str]]


def plan(profile: str, config: Config) -> Plan:
    """What makes this machine the host that the profile says."""
    source = deploy_folder()
    names = config.system.services
    files = {
        SYSTEMD / "clew@.service": (0o644, (source / "systemd/clew@.service").read_text()),
        SYSTEMD / "clew.target": (0o644, (source / "systemd/clew.target").read_text()),
        ETC / "host.env": (0o644, f"CLEW_PROFILE={Path(profile).resolve() if Path(profile).is_file() else profile}\n"),
    }
    for name in names:
        for drop_in in _drop_ins(name):
            text = (source / f"systemd/{drop_in}.conf").read_text()
            files[SYSTEMD / f"clew@{name}.service.d" / f"{drop_in}.conf"] = (0o644, text)
    if "px4_bridge" in names:
        rules = "60-clew-autopilot.rules"
        files[UDEV / rules] = (0o644, (source / "udev" / rules).read_text())
    units = [f"clew@{name}.service" for name in names]
    commands = [
        ["useradd", "--system", "--user-group", "--no-create-home", "--shell", "/usr/sbin/nologin", "clew"],
        ["install", "-d", "-o", "clew", "-g", "clew", "-m", "700", "/etc/clew/certs"],
        ["systemctl", "daemon-reload"],
        ["systemctl", "enable", "clew.target", *units],
    ]
    return Plan(files, commands)


def _drop_ins(name: str) -> list[str]:
    return ["onboard"] if name in ONBOARD else ["recorder"] if name == "recorder" else []


def install(profile: str, *, dry_run: bool, root: Path = Path("/")) -> int:
    """Carry the plan out. Returns the exit code: 2 for bad input or without root."""
    try:
        config = load(profile)
        if not config.hosts or config.system.host == "console":
            raise ConfigError(f"{profile}: is no host of a system of two: drone or ground")
        if not dry_run and root == Path("/") and (os.geteuid() != 0 or not shutil.which("systemctl")):
            raise ConfigError("clew install: needs root and systemd; --dry-run shows what it would do")
    except ConfigError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    made = plan(profile, config)
    for path, (mode, text) in made.files.items():
        _tell(f"write /{path}")
        if not dry_run:
            (root / path).parent.mkdir(parents=True, exist_ok=True)
            (root / path).write_text(text)
            (root / path).chmod(mode)
    for command in made.commands:
        _tell(" ".join(command))
        if not dry_run and root == Path("/"):
            done = subprocess.run(command, check=False)
            if done.returncode not in ((0, 9) if command[0] == "useradd" else (0,)):  # 9: the user is there already
                return 1
    name = ", ".join(config.radio.of_role(config.system.host)) if config.radio else ""
    _tell(
        f"now put ca.pem, {name}.pem and {name}.key into /etc/clew/certs, owned by clew (chown clew: /etc/clew/certs/*)"
    )
    _tell("then: systemctl start clew.target; journalctl -u 'clew@*' shows what each service says")
    return 0


def _tell(line: str) -> None:
    print(line)  # noqa: T201
