"""`clew ...` for what has been recorded: every command is one function elsewhere."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()

File = Annotated[Path, typer.Argument(help="a recording, or a session's folder")]


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
    from services import rerun

    raise typer.Exit(rerun.command(file, service or [], set_ or [], figure))
