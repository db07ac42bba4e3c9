"""`clew faults`: the campaign of injected faults on the simulated system, on virtual time."""

import sys
import time
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, help="Break the simulated system in every known way and measure what it does.")

Jobs = Annotated[int, typer.Option(help="processes at once; 0: one for each processor")]


@app.command("list")
def show() -> None:
    """Every fault, what it must lead to, and by when."""
    from rich.table import Table

    from services.console.terminal import console
    from services.faults.catalogue import every

    table = Table("fault", "what breaks", "must lead to", "within s")
    for fault in every():
        table.add_row(fault.name, fault.about, fault.reaction.value, f"{fault.within_s:g}" if fault.within_s else "-")
    console().print(table)


@app.command()
def run(name: str, out: Annotated[Path, typer.Option(help="where the time line goes")] = Path("faults")) -> None:
    """One fault, with its time line as a picture."""
    from services.console.terminal import console
    from services.faults import report
    from services.faults.campaign import campaign
    from services.faults.catalogue import named

    fault = named(name)
    if fault is None:
        print(f"no fault {name!r}; clew faults list shows them", file=sys.stderr)  # noqa: T201
        raise typer.Exit(2)
    out.mkdir(parents=True, exist_ok=True)
    (result,) = campaign([fault], 1, report.pictures(out))
    console().print(report.table([result]))
    for reason in result.reasons:
        console().print(f"said: {reason}")
    console().print(f"{out}/{name}.png")
    raise typer.Exit(0 if result.ok else 1)


@app.command("all")
def whole(
    jobs: Jobs = 0,
    pictures: Annotated[Path | None, typer.Option(help="a folder for a time line of each fault")] = None,
    into: Annotated[Path | None, typer.Option(help="a document to write the table of measured times into")] = None,
) -> None:
    """The whole campaign; exit code 1 where a promise was not kept."""
    from services.console.terminal import console
    from services.faults import report
    from services.faults.campaign import campaign, processors
    from services.faults.catalogue import every

    faults, began = every(), time.monotonic()
    if pictures:
        pictures.mkdir(parents=True, exist_ok=True)
    look = report.pictures(pictures) if pictures else None
    results = campaign(faults, jobs or processors(), look)
    console().print(report.table(results))
    failed = sum(not result.ok for result in results)
    console().print(f"{len(results)} faults, {failed} with a broken promise, {time.monotonic() - began:.0f} s")
    if into:
        into.write_text(report.insert(into.read_text(), report.written(faults, results)))
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
