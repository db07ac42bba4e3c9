"""Options that commands share."""

from typing import Annotated

import typer

Profile = Annotated[str, typer.Option(help="a name in deploy/profiles, or a file")]
Px4 = Annotated[str, typer.Option(help="PX4's program for a profile that simulates with it", envvar="PX4_BIN")]
