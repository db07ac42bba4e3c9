"""`clew rerun`: a session's recorded inputs through the present code; equal bytes, or the first message that differs."""

import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, cast

from rich.console import Console
from rich.table import Table

from services import config as configuration
from services.config import Config, ConfigError
from services.recorder.reading import Session, read
from services.recorder.rerun import CannotRerun, Outcome, rerun, thinned_for
from services.recorder.rerun_subjects import SUBJECTS
from services.recorder.walk import CONFIG_ATTACHMENT, config_of
from services.recorder.what_if import draw
from services.session_files import complain, session_file


def command(given: Path, services: Sequence[str], settings: Sequence[str], figure: Path | None) -> int:
    """Returns 0 when every service said the same bytes again, 1 when one did not, 2 when it could not be run.

    With `settings` it is a what-if: a difference is the answer, not a failure, and both curves are drawn.
    """
    try:
        file = session_file(given)
        session = read(file)
        config = config_with(session, file, settings)
        chosen = _chosen(services, session, config)
        outcomes = [rerun(session, name, config) for name in chosen]
    except (OSError, ValueError, ConfigError) as error:
        return complain(error)
    console = Console()
    console.print(_table(outcomes))
    for line in (*_remarks(outcomes, session.damage), *_left_out(session, config, chosen)):
        console.print(line, soft_wrap=True, highlight=False, markup=False)
    if settings or figure:
        drawn = draw(session, outcomes, figure or file.with_name("what_if.png"))
        console.print(f"both curves: {drawn}" if drawn else "nothing differs: nothing to draw", soft_wrap=True)
    return 0 if settings or all(outcome.equal for outcome in outcomes) else 1


def config_with(session: Session, file: Path, settings: Sequence[str]) -> Config:
    """The recorded configuration with some values replaced.

    Raises:
        ConfigError: there is none, a key does not exist, or a value does not do; in one line each.
    """
    data = config_of(session)
    if not data:
        raise ConfigError(f"{file}: holds no configuration ({CONFIG_ATTACHMENT})")
    for setting in settings:
        _set(data, *_key_and_value(setting))
    return configuration.of_recording(file, data)


def _key_and_value(setting: str) -> tuple[str, Any]:
    key, equals, text = setting.partition("=")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    if not equals or not text:
        raise ConfigError(f"--set {setting}: must be key=value, such as px4_bridge.admittance.b_A_Ns_per_m=3.0")
    return key, value


def _set(data: dict[str, Any], key: str, value: Any) -> None:
    *parents, last = key.split(".")
    table: Any = data
    for part in parents:
        table = cast("dict[str, Any]", table).get(part) if isinstance(table, dict) else None
    if not isinstance(table, dict) or last not in table:
        near = ", ".join(sorted(cast("dict[str, Any]", table))) if isinstance(table, dict) else ", ".join(sorted(data))
        raise ConfigError(f"--set {key}: no such parameter; there are {near}")
    table[last] = value


def _chosen(services: Sequence[str], session: Session, config: Config) -> list[str]:
    """Those asked for, or all that said anything and whose inputs the recorder heard whole."""
    if unknown := set(services) - set(SUBJECTS):
        raise CannotRerun(f"--service {', '.join(sorted(unknown))}: must be one of {', '.join(SUBJECTS)}")
    whole = [name for name in _spoke(session) if not thinned_for(name, config)]
    if not (services or whole):
        raise CannotRerun("no service that can be run again said anything in this recording")
    return list(services) or whole


def _spoke(session: Session) -> list[str]:
    heard = session.logs_of(subject.turns.key for subject in SUBJECTS.values())
    return [name for name, subject in SUBJECTS.items() if subject.turns.key in heard]


def _left_out(session: Session, config: Config, chosen: Sequence[str]) -> Iterator[str]:
    for name in _spoke(session):
        if name not in chosen and (thinned := thinned_for(name, config)):
            yield f"{name}: not run, {', '.join(thinned)} crossed the radio thinned"


def _table(outcomes: Sequence[Outcome]) -> Table:
    table = Table("service", "messages", "differ", "recorded", "took", "")
    for column in table.columns[1:5]:
        column.justify = "right"
    for o in outcomes:
        speed = f"{o.took_s:.1f} s ({o.recorded_s / o.took_s:.0f}x)"
        table.add_row(
            o.service, str(o.compared), str(o.differ), f"{o.recorded_s:.1f} s", speed, "equal" if o.equal else "DIFFERS"
        )
    return table


def _remarks(outcomes: Sequence[Outcome], damage: str) -> Iterator[str]:
    if damage:
        yield f"the recording is damaged: {damage}"
    for outcome in outcomes:
        if outcome.first:
            yield f"{outcome.service}: {outcome.first}"
        for note in outcome.notes:
            yield f"{outcome.service}: {note}"
