"""Where tables are printed."""

from rich.console import Console

PIPE_WIDTH = 200


def console() -> Console:
    """As wide as the terminal; in a pipe wide enough that nothing is cut."""
    made = Console()
    return made if made.is_terminal else Console(width=PIPE_WIDTH)
