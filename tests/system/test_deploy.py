"""What `deploy/` gives to other programs is looked at by those programs, where they are installed."""

import shutil
import subprocess
from pathlib import Path

import pytest

from services.config import load
from services.console.install import install

UNITS, COMPOSE = Path("/usr/lib/systemd/system"), Path("deploy/compose.yaml")


def verified(root: Path, *units: str) -> tuple[int, str]:
    """What systemd says about units of a host's file system."""
    command = ["systemd-analyze", "verify", "--man=no", f"--root={root}", *units]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.skipif(not (shutil.which("systemd-analyze") and UNITS.is_dir()), reason="no systemd is installed")
@pytest.mark.parametrize("host", ["drone", "ground"])
def test_systemd_has_nothing_to_say_against_the_units(host: str, tmp_path: Path):
    assert install(host, dry_run=False, root=tmp_path) == 0
    shutil.copytree(UNITS, tmp_path / UNITS.relative_to("/"), symlinks=True)
    program = tmp_path / "opt/clew/bin/clew"
    program.parent.mkdir(parents=True)
    program.touch(0o755)
    units = ("clew.target", *(f"clew@{name}.service" for name in load(host).system.services))
    assert verified(tmp_path, *units) == (0, "")
    template = tmp_path / "etc/systemd/system/clew@.service"
    template.write_text(template.read_text().replace("Restart=always", "Restart=allways"))
    assert "allways" in verified(tmp_path, units[1])[1], "it does look"


def compose() -> list[str]:
    """The command of that name, as a plug-in of docker or by itself."""
    if shutil.which("docker") and not subprocess.run(["docker", "compose", "version"], capture_output=True).returncode:
        return ["docker", "compose"]
    return ["docker-compose"] if shutil.which("docker-compose") else []


@pytest.mark.skipif(not compose(), reason="no docker compose is installed")
def test_compose_takes_the_file():
    command = [*compose(), "-f", str(COMPOSE), "config"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
    assert done.returncode == 0, done.stderr
    assert "ground-sim" in done.stdout
