"""`clew`: every command is one function elsewhere."""

import signal
from pathlib import Path
from typing import Annotated

import typer

from services.console import cli_calibrate, cli_faults, cli_sessions
from services.console.options import Profile, Px4

app = typer.Typer(
    no_args_is_help=True, add_completion=False, help="Clew guides a person by the hand with a tethered drone."
)

app.add_typer(cli_sessions.app)
app.add_typer(cli_calibrate.app)
app.add_typer(cli_faults.app, name="faults")


@app.command()
def demo(
    profile: Profile = "demo",
    path: Annotated[str, typer.Option(help="a name in deploy/paths, or a file")] = "",
    person: Annotated[str, typer.Option(help="a name in deploy/people, or a file")] = "",
    seed: Annotated[int | None, typer.Option(help="of all simulated noise")] = None,
    out: Annotated[Path, typer.Option(help="where session folders go")] = Path("sessions"),
    live: Annotated[bool, typer.Option(help="the live panel")] = True,
    px4: Px4 = "",
    subject: cli_sessions.Subject = "",
    condition: cli_sessions.Condition = "",
) -> None:
    """Fly the experiment once, simulated, from take-off to landing, and show what happened."""
    from services.console import demo as demonstration
    from services.console import start

    choice = start.Choice(
        profile=profile, path=path, person=person, seed=seed, px4=px4, subject=subject, condition=condition, out=out
    )
    raise typer.Exit(demonstration.demo(choice, live))


@app.command(name="map")
def stability_map(
    vehicle: Annotated[str, typer.Option(help="names in deploy/vehicles, or files, by commas")] = "medium,light",
    ratio: Annotated[str, typer.Option(help="virtual masses M_A/m_R")] = "0.53,0.67,0.8,0.9,1,1.33,2",
    k_c: Annotated[str, typer.Option(help="cable stiffness, N/m; 50..400 for five values")] = "50,100,200,400",
    observer_hz: Annotated[str, typer.Option(help="bandwidth of the wrench observer, Hz")] = "8",
    delay_ms: Annotated[str, typer.Option(help="each way between autopilot and companion, ms")] = "8",
    d_c: Annotated[float, typer.Option(help="damping of the cable, N s/m")] = 1.0,
    lead_s: Annotated[float | None, typer.Option(help="lead of the set-point, s; the profile's by default")] = None,
    seconds: Annotated[float, typer.Option(help="flight of each cell")] = 20.0,
    profile: Profile = "demo",
    out: Annotated[Path, typer.Option(help="where figure and cells go")] = Path("stability"),
) -> None:
    """Which virtual masses a vehicle that lags can fly on which cables."""
    from services.campaign import stability_map

    asked = stability_map.Asked(vehicle, ratio, k_c, observer_hz, delay_ms, d_c, lead_s, seconds, profile)
    raise typer.Exit(stability_map.run(asked, out))


@app.command()
def run(service: str, profile: Profile = "demo", px4: Px4 = "") -> None:
    """Run one service in the foreground."""
    from services.console import start

    raise typer.Exit(start.run_by_hand(service, profile, px4))


@app.command()
def up(
    profile: Annotated[str, typer.Argument(help="a name in deploy/profiles, or a file")] = "demo",
    out: Path = Path("sessions"),
    px4: Px4 = "",
    subject: cli_sessions.Subject = "",
    condition: cli_sessions.Condition = "",
) -> None:
    """Run all services of a profile until Ctrl-C."""
    from services.console import start

    raise typer.Exit(start.up(start.Choice(profile=profile, px4=px4, subject=subject, condition=condition, out=out)))


@app.command()
def preflight(
    profile: Profile = "demo",
    fix: Annotated[bool, typer.Option("--fix", help="set the autopilot's parameters as the profile has them")] = False,
    sessions: Annotated[Path, typer.Option(help="where recordings are, for the last zeroing")] = Path("sessions"),
) -> None:
    """What stands against a flight, in the order in which to mend it; the system must not run meanwhile."""
    from services.console import preflight as checks

    raise typer.Exit(checks.preflight(profile, fix, sessions))


@app.command()
def topics(profile: Profile = "demo") -> None:
    """The topic table."""
    from services.console import look

    look.topics()


@app.command()
def echo(
    topic: str,
    profile: Profile = "demo",
    count: Annotated[int, typer.Option("-n", help="stop after so many")] = 0,
    replay: cli_sessions.Replay = False,
) -> None:
    """Print the messages of a topic as JSON, one a line."""
    from services.console import look

    raise typer.Exit(look.echo(topic, profile, count, replay=replay))


@app.command()
def hz(
    topics: Annotated[list[str] | None, typer.Argument()] = None,
    profile: Profile = "demo",
    seconds: float = 2.0,
    replay: cli_sessions.Replay = False,
) -> None:
    """The rate at which topics arrive, beside the table's; all of them by default."""
    from services.console import look

    raise typer.Exit(look.hz(topics or [], profile, seconds, replay=replay))


@app.command()
def status(profile: Profile = "demo") -> None:
    """Who is there, how they are, and what limits the system now."""
    from services.console import look

    raise typer.Exit(look.status(profile))


def _command(name: str, action: str, help_text: str) -> None:
    """A person's command, under its own name."""

    @app.command(name, help=help_text)
    def give(profile: Profile = "demo") -> None:  # pyright: ignore[reportUnusedFunction]  (typer has it)
        from schemas.safety import Action
        from services.console import operator

        raise typer.Exit(operator.command(Action(action), profile))


_command("start", "start", "Ask for the take-off of a system that is up.")
_command("stop", "ease", "Take all force away at once; the cable hangs slack. `clew resume` goes on.")
_command("hold", "hold", "As stop, and stand there until a person resumes.")
_command("land", "land", "Fly aside and land; it cannot be taken back.")
_command("kill", "kill", "Stop the motors at once, in the air too: the vehicle falls.")
_command("resume", "resume", "Go on after stop or hold, if nothing else limits the system.")


@app.command()
def explain(
    session: Annotated[Path, typer.Argument(help="a recording: session.mcap, or its folder")],
    out: Annotated[Path | None, typer.Option(help="where energy.png goes; beside the recording by default")] = None,
) -> None:
    """Where a session's energy went: V, its rate, and the balance at each port."""
    from services.console import explain as explanation

    raise typer.Exit(explanation.explain(session, out))


@app.command()
def campaign(
    more: Annotated[list[Path] | None, typer.Argument(metavar="[SESSIONS]", help="more recordings for --from")] = None,
    people: Annotated[int, typer.Option(help="how many different people walk")] = 4,
    trials: Annotated[int, typer.Option(help="how often each of them walks")] = 2,
    seed: Annotated[int, typer.Option(help="of everything drawn")] = 1,
    population: Annotated[str, typer.Option(help="a name in deploy/populations, or a file")] = "paper",
    controller: Annotated[str, typer.Option(help="reference, literal or regulation")] = "reference",
    robot: Annotated[str, typer.Option(help="ideal, or px4: a PX4-like vehicle")] = "ideal",
    vary: Annotated[str, typer.Option(help="spread over the people, as m_H=2..12,k_c=100,200,delay_ms=0..80")] = "",
    seconds: Annotated[float, typer.Option(help="of each walk")] = 60.0,
    jobs: Annotated[int, typer.Option(help="processes")] = 1,
    out: Annotated[Path | None, typer.Option(help="the campaign's folder; by default a new one in campaigns/")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="go on with the campaign in --out, by its own plan")] = False,
    recording: Annotated[
        Path | None, typer.Option("--from", help="no simulation: statistics of recorded sessions")
    ] = None,
    path: Annotated[str, typer.Option(help="a name in deploy/paths, or a file")] = "",
    profile: Profile = "demo",
) -> None:
    """Let many people walk, by the laws that fly but without the bus, and write the paper's statistics."""
    from services.campaign.command import Options
    from services.campaign.command import campaign as run_campaign

    if more and recording is None:
        raise typer.BadParameter(f"{more[0]}: recordings come after --from")
    options = Options(
        profile=profile,
        path=path,
        population=population,
        people=people,
        trials=trials,
        seed=seed,
        controller=controller,
        robot=robot,
        vary=vary,
        seconds=seconds,
        jobs=jobs,
        out=out,
        resume=resume,
        sessions=[recording, *(more or [])] if recording is not None else [],
    )
    raise typer.Exit(run_campaign(options))


@app.command()
def link(
    profile: Profile = "ground",
    as_json: Annotated[bool, typer.Option("--json", help="once, as JSON")] = False,
    seconds: Annotated[float, typer.Option(help="over which it is measured")] = 2.0,
) -> None:
    """The radio between the hosts: round trip, clocks, loss and age of each topic."""
    from services.console import link as radio

    raise typer.Exit(radio.link(profile, as_json=as_json, seconds=seconds))


@app.command()
def install(
    profile: Annotated[str, typer.Argument(help="drone or ground, or a profile for one of them")],
    dry_run: Annotated[bool, typer.Option(help="only say what it would do")] = False,
) -> None:
    """Make this machine start its host's services at boot (systemd; needs root)."""
    from services.console import install as installer

    raise typer.Exit(installer.install(profile, dry_run=dry_run))


certs = typer.Typer(
    no_args_is_help=True, help="The radio's certificates: a private authority, one for each host and console."
)
app.add_typer(certs, name="certs")


@certs.command("init")
def certs_init() -> None:
    """Make the authority, in $CLEW_CERTS_DIR or ~/.config/clew/certs."""
    from services.console import cli_certs

    raise typer.Exit(cli_certs.init())


@certs.command("issue")
def certs_issue(
    name: str,
    role: Annotated[str, typer.Option(help="drone, ground, operator or viewer")],
    address: Annotated[list[str] | None, typer.Option(help="name or IP under which it is reached; repeatable")] = None,
    days: float = 400.0,
) -> None:
    """Make a certificate for NAME, signed by the authority."""
    from services.console import cli_certs

    raise typer.Exit(cli_certs.issue(name, role, address or [], days))


@certs.command("show")
def certs_show() -> None:
    """Who has a certificate here, as what, until when, and what is wrong with it."""
    from services.console import cli_certs

    raise typer.Exit(cli_certs.show())


def main() -> None:
    """The console script. Ctrl-C counts also where a script that put it in the background had it ignored."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    app()


if __name__ == "__main__":
    main()
