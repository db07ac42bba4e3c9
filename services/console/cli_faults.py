"""`clew faults`: the campaign of injected faults on virtual time, on the simulated system or on real PX4 in software."""

import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from services.console.options import Profile, Px4

if TYPE_CHECKING:
    from collections.abc import Sequence

    from services.config import Config
    from services.faults.campaign import Look
    from services.faults.fault import Fault
    from services.faults.measure import Result

app = typer.Typer(no_args_is_help=True, help="Break the simulated system in every known way and measure what it does.")

Jobs = Annotated[int, typer.Option(help="processes at once; 0: one for each processor; PX4 flies one after the other")]


@app.command("list")
def show() -> None:
    """Every fault, what it must lead to, and by when; PX4 flies those that are marked in `all`, and the others by name."""
    from rich.table import Table

    from services.console.terminal import console
    from services.faults.catalogue import every
    from services.faults.on_px4 import one_of_each

    table, chosen = Table("fault", "what breaks", "must lead to", "within s", "on PX4"), {f.name for f in one_of_each()}
    for fault in every():
        on_px4 = (
            f"not: {fault.on_px4.not_flown}" if fault.on_px4.not_flown else "in all" if fault.name in chosen else ""
        )
        within = f"{fault.within_s:g}" if fault.within_s else "-"
        table.add_row(fault.name, fault.about, fault.reaction.value, within, on_px4)
    console().print(table)


@app.command()
def run(
    context: typer.Context,
    name: str,
    out: Annotated[Path, typer.Option(help="where the time line goes; on PX4 also the session")] = Path("faults"),
    profile: Profile = "demo",
    px4: Px4 = "",
) -> None:
    """One fault, with its time line as a picture. With --profile px4-sitl real PX4 flies."""
    from services.console.terminal import console
    from services.faults import report
    from services.faults.catalogue import named

    fault = named(name)
    if fault is None:
        _refuse(f"no fault {name!r}; clew faults list shows them")
    config = _config(context, profile, px4)
    out.mkdir(parents=True, exist_ok=True)
    (result,) = _flown([fault], config, 1, report.pictures(out), out)
    console().print(report.table([result]))
    for reason in result.reasons:
        console().print(f"said: {reason}")
    if not result.not_flown:
        console().print(f"{out}/{name}.png")
    raise typer.Exit(0 if result.ok else 1)


@app.command("all")
def whole(
    context: typer.Context,
    jobs: Jobs = 0,
    pictures: Annotated[Path | None, typer.Option(help="a folder for a time line of each fault")] = None,
    into: Annotated[Path | None, typer.Option(help="a document to write the table of measured times into")] = None,
    profile: Profile = "demo",
    px4: Px4 = "",
) -> None:
    """The whole campaign, on PX4 one of each family; exit code 1 where a promise was not kept."""
    from services.console.terminal import console
    from services.faults import on_px4, report
    from services.faults.catalogue import every

    config, began = _config(context, profile, px4), time.monotonic()
    by_px4 = config.simulator.px4_sitl is not None
    faults = on_px4.one_of_each() if by_px4 else every()
    if pictures:
        pictures.mkdir(parents=True, exist_ok=True)
    look = report.pictures(pictures) if pictures else None
    with tempfile.TemporaryDirectory() as folder:
        results = _flown(faults, config, jobs, look, Path(folder))
    console().print(report.table(results))
    failed, left = sum(not result.ok for result in results), sum(bool(result.not_flown) for result in results)
    said = f"{len(results)} faults, {left} not flown, {failed} with a broken promise, {time.monotonic() - began:.0f} s"
    console().print(said)
    if into:
        place = report.PX4_TABLE if by_px4 else report.TABLE
        into.write_text(report.insert(into.read_text(), report.written(faults, results), place))
    raise typer.Exit(1 if failed else 0)


@app.command()
def nominal(
    count: Annotated[int, typer.Option("--flights", "-n", help="how many")] = 100,
    jobs: Jobs = 0,
    first_seed: Annotated[int, typer.Option(help="the others follow it")] = 1,
) -> None:
    """Flights in which nothing breaks: other people, seeds and delays; exit code 1 where one alarms or breaks a promise."""
    from services.console.terminal import console
    from services.faults.campaign import processors
    from services.faults.nominal import flights

    failed, screen = 0, console()
    for done in flights(count, jobs or processors(), first_seed):
        if not done.ok:
            failed += 1
            wrong = "; ".join((*done.said, *done.broken))
            screen.print(f"seed {done.seed} ({done.who}): {done.phase}, {done.level.name.lower()}: {wrong}")
    screen.print(f"{count} flights, {failed} with an alarm above warn or a broken promise")
    raise typer.Exit(1 if failed else 0)


def _refuse(why: object) -> NoReturn:
    print(why, file=sys.stderr)  # noqa: T201
    raise typer.Exit(2)


def _config(context: typer.Context, profile: str, px4: str) -> "Config":
    """What flies; or it ends with 2 and one line."""
    from services.config import ConfigError, load
    from services.console.start import check_px4

    try:
        config = load(profile, px4=px4)
        sitl = config.simulator.px4_sitl
        if config.hosts:
            raise ConfigError(f"{profile}: faults are flown on one host")
        given = context.get_parameter_source("px4")
        if sitl is None and given is not None and given.name == "COMMANDLINE":  # PX4_BIN may stand there for others
            raise ConfigError(f"--px4: the profile {profile} does not fly PX4: --profile px4-sitl does")
        if sitl is not None and not sitl.binary:
            raise ConfigError("PX4 is started anew for each fault: give its program by --px4 or PX4_BIN")
        check_px4(config)
        return config
    except ConfigError as error:
        _refuse(error)


def _flown(faults: "Sequence[Fault]", config: "Config", jobs: int, look: "Look | None", folder: Path) -> "list[Result]":
    """By the vehicle of the profile; flights one after the other are counted as they come."""
    from services.console.terminal import console
    from services.faults import on_px4
    from services.faults.campaign import campaign, processors

    if config.simulator.px4_sitl is None:
        return campaign(faults, jobs or processors(), look, config)
    results = list["Result"]()
    for result in on_px4.campaign(faults, config, folder, look):
        results.append(result)
        if len(faults) > 1:
            console().print(f"{len(results)}/{len(faults)} {result.name}: {result.verdict}", markup=False)
    return results
