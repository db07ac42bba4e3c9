"""`make figures`: every picture in docs/figures, made anew: one demo flight, the stability map, a campaign and
the radio's delay.

The demo's own figures come from its session folder, at a resolution fit for a page.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.flight_demo import fly

DOCS = Path(__file__).parent.parent / "docs" / "figures"


def main() -> None:
    """Write the pictures."""
    DOCS.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        summary = fly(Path(folder), seed=1)
        shots = [summary["folder"] / name for name in ("path.png", "time.png")]
        for file in shots:
            shutil.copy(file, DOCS / file.name)
        for name, lead in (("stability_map", ()), ("stability_map_no_lead", ("--lead-s", "0"))):
            command = [sys.executable, "-m", "services.console.cli", "map", "--out", folder, *lead]
            subprocess.run(command, check=True)
            shutil.copy(Path(folder) / "stability_map.png", DOCS / f"{name}.png")
        out = Path(folder) / "campaign"
        subprocess.run([sys.executable, "-m", "services.console.cli", "campaign", "--out", str(out)], check=True)
        shutil.copy(out / "walks.png", DOCS / "campaign.png")
    for name in ("campaign", "delay"):
        subprocess.run([sys.executable, "-m", f"benchmarks.{name}", "--out", str(DOCS)], check=True)
    print("\n".join(str(file.relative_to(DOCS.parent.parent)) for file in sorted(DOCS.glob("*.png"))))


if __name__ == "__main__":
    main()
