"""The page of a report in a browser: it comes up without an error, and its slider moves."""

import shutil
import subprocess
from pathlib import Path

import pytest

from services.console import sessions
from services.recorder.figures import FIGURES
from services.recorder.page import write_page
from services.recorder.reading import read
from tests.services import synthetic
from tests.services.synthetic_world import Scenario

QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--enable-logging=stderr", "--virtual-time-budget=2000",
)  # fmt: skip
SCRIPT = """
<script>
document.getElementById("time").value = 3; document.getElementById("time").oninput();
document.getElementById("play").onclick(); document.getElementById("play").onclick();
{ const one = link.plots[0]; one.zoom([1, 2]); one.hover = 1.5; one.draw(); document.body.dataset.view = one.view.join(); }
</script>
"""


def browsed(page, profile):
    """The document as the browser made it of the page, and what it complained about."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium is installed")
    command = [browser, *QUIET, f"--user-data-dir={profile}", "--dump-dom", page.as_uri()]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    return ended.stdout, [line for line in ended.stderr.splitlines() if "CONSOLE" in line]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sessions")
    good = synthetic.write(folder / "one" / "session.mcap", Scenario(guiding_s=4.0))
    other = synthetic.write(folder / "two" / "session.mcap", Scenario(guiding_s=4.0, drift_m=-0.05, truth=False))
    return [good, other]


@pytest.mark.parametrize("count", [1, 2])
def test_a_browser_shows_the_page(files, tmp_path, count):
    page = write_page([read(file) for file in files[:count]], tmp_path / "report.html")
    page.write_text(page.read_text().replace("</body>", f"{SCRIPT}</body>"))
    document, complaints = browsed(page, tmp_path / "profile")
    assert complaints == []
    assert 'data-ready="yes"' in document
    assert 'data-view="1,2"' in document
    assert "path error, mean" in document
    assert document.count("simulator -&gt; tracker") == count
    assert "3.0 s" in document or "guiding" in document


def test_a_session_of_nothing_still_makes_a_page(tmp_path):
    file = synthetic.write(tmp_path / "session.mcap", Scenario(guiding_s=1.5))
    file.write_bytes(file.read_bytes()[:200_000])
    page = write_page([read(file)], tmp_path / "report.html")
    document, complaints = browsed(page, tmp_path / "profile")
    assert complaints == []
    assert 'data-ready="yes"' in document


def test_the_command_writes_page_and_figures(files, tmp_path, capsys):
    assert sessions.report(files[:1], tmp_path / "page.html", tmp_path / "figures") == 0
    assert "https://" not in (tmp_path / "page.html").read_text().replace("http://www.w3.org", "")
    drawn = sorted(file.name for file in (tmp_path / "figures" / "one").iterdir())
    assert drawn == sorted(str(Path(name).with_suffix(kind)) for name in FIGURES for kind in (".pdf", ".png"))
    assert sessions.report([tmp_path / "none"], None, None) == 2
    assert "no recording there" in capsys.readouterr().err
