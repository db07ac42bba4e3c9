"""`clew`: every command is one function elsewhere."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    no_args_is_help=True, add_completion=False, help="Clew guides a person by the hand with a tethered drone."
)

Profile = Annotated[str, typer.Option(help="a name in deploy/profiles, or a file")]


@app.command()
def demo(
    profile: Profile = "demo",
    path: Annotated[str, typer.Option(help="a name in deploy/paths, or a file")] = "",
    person: Annotated[str, typer.Option(help="a name in deploy/people, or a file")] = "",
    seed: Annotated[int | None, typer.Option(help="of all simulated noise")] = None,
    out: Annotated[Path, typer.Option(help="where session folders go")] = Path("sessions"),
    live: Annotated[bool, typer.Option(help="the live panel")] = True,
) -> None:
    """Fly the experiment once, simulated, from take-off to landing, and show what happened."""
    from services import demo as demonstration

    raise typer.Exit(demonstration.demo(profile, path, person, seed, out, live))


@app.command()
def run(service: str, profile: Profile = "demo") -> None:
    """Run one service in the foreground."""
    from services import start

    raise typer.Exit(start.run_by_hand(service, profile))


@app.command()
def up(
    profile: Annotated[str, typer.Argument(help="a name in deploy/profiles, or a file")] = "demo",
    out: Path = Path("sessions"),
) -> None:
    """Run all services of a profile until Ctrl-C."""
    from services import start

    raise typer.Exit(start.up(profile, out))


@app.command()
def topics(profile: Profile = "demo") -> None:
    """The topic table."""
    from services import look

    look.topics()


@app.command()
def echo(
    topic: str, profile: Profile = "demo", count: Annotated[int, typer.Option("-n", help="stop after so many")] = 0
) -> None:
    """Print the messages of a topic as JSON, one a line."""
    from services import look

    raise typer.Exit(look.echo(topic, profile, count))


@app.command()
def hz(
    topics: Annotated[list[str] | None, typer.Argument()] = None, profile: Profile = "demo", seconds: float = 2.0
) -> None:
    """The rate at which topics arrive, beside the table's; all of them by default."""
    from services import look

    raise typer.Exit(look.hz(topics or [], profile, seconds))


@app.command()
def status(profile: Profile = "demo") -> None:
    """Who is there, how they are, and what limits the system now."""
    from services import look

    raise typer.Exit(look.status(profile))


@app.command()
def explain(
    session: Annotated[Path, typer.Argument(help="a recording: session.mcap")],
    out: Annotated[Path | None, typer.Option(help="where energy.png goes; beside the recording by default")] = None,
) -> None:
    """Where a session's energy went: V, its rate, and the balance at each port."""
    from services import explain as explanation

    raise typer.Exit(explanation.explain(session, out))


def main() -> None:
    """The console script."""
    app()


if __name__ == "__main__":
    main()
