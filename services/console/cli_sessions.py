"""`clew ...` for what has been recorded: every command is one function elsewhere."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()

File = Annotated[Path, typer.Argument(help="a recording, or a session's folder")]


Profile = Annotated[str, typer.Option(help="a name in deploy/profiles, or a file")]


Subject = Annotated[str, typer.Option(help="who walks, by the study's own code; kept in the recording")]
Condition = Annotated[str, typer.Option(help="the study's condition; kept in the recording")]


Replay = Annotated[bool, typer.Option("--replay", help="look into a replay, not into the living system")]


@app.command()
def check(file: File) -> None:
    """Is a recording complete, and why not."""
    from services.console import sessions

    raise typer.Exit(sessions.check(file))


@app.command()
def recover(
    file: File, out: Annotated[Path | None, typer.Option(help="where to write what could be saved")] = None
) -> None:
    """Save what a power cut or a kill left of a recording."""
    from services.console import sessions

    raise typer.Exit(sessions.save(file, out))


@app.command()
def replay(
    file: File,
    speed: Annotated[float, typer.Option(help="times real time")] = 1.0,
    start: Annotated[float, typer.Option(help="s into the session")] = 0.0,
) -> None:
    """Say a recording again, on a bus of its own; never beside a vehicle."""
    from services.console import replay

    raise typer.Exit(replay.command(file, speed, start))


@app.command()
def view(
    file: File,
    port: Annotated[int, typer.Option(help="of the page; 0 takes a free one")] = 8090,
    browser: Annotated[bool, typer.Option(help="open the page in the browser")] = True,
) -> None:
    """Serve a recording, its scene and layouts to Foxglove or Lichtblick, and the report."""
    from services.viewer import view

    raise typer.Exit(view.command(file, port, browser))


@app.command()
def live(
    profile: Profile = "demo",
    host: Annotated[str, typer.Option(help="0.0.0.0 lets others look too")] = "127.0.0.1",
    port: int = 8765,
    replay: Replay = False,
) -> None:
    """The running system in Foxglove or Lichtblick."""
    from services.viewer import live

    raise typer.Exit(live.command(profile, host, port, replay=replay))


@app.command()
def report(
    files: Annotated[list[Path], typer.Argument(help="recordings, or sessions' folders; several are compared")],
    out: Annotated[Path | None, typer.Option(help="the page; by default report.html beside the recording")] = None,
    figures: Annotated[Path | None, typer.Option(help="where to draw the paper's figures too, as PNG and PDF")] = None,
) -> None:
    """One page with everything about a session, or several compared."""
    from services.console import sessions

    raise typer.Exit(sessions.report(files, out, figures))


@app.command()
def sessions(folder: Annotated[Path, typer.Argument(help="where session folders are")] = Path("sessions")) -> None:
    """What has been recorded, a line for each session."""
    from services.console import sessions

    raise typer.Exit(sessions.overview(folder))


@app.command()
def note(text: str, profile: Profile = "demo") -> None:
    """Write a remark into the recording that runs."""
    from services.console import sessions

    raise typer.Exit(sessions.note(text, profile))


@app.command()
def rerun(
    file: File,
    service: Annotated[list[str] | None, typer.Option(help="only this one; may be repeated")] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="key=value of the configuration: a what-if; may be repeated")
    ] = None,
    figure: Annotated[Path | None, typer.Option(help="where to draw what differs")] = None,
) -> None:
    """Run services again on what they heard: the same bytes, or the first message that differs."""
    from services.console import rerun

    raise typer.Exit(rerun.command(file, service or [], set_ or [], figure))
