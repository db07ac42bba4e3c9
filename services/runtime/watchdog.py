"""The service manager's watchdog (systemd), fed from within the loop: a loop that hangs is ended and started anew."""

import os
import socket


def feed() -> None:
    """Say that the loop turns; does nothing where no service manager listens."""
    path = os.environ.get("NOTIFY_SOCKET", "")
    if not path:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.setblocking(False)
        try:
            manager.sendto(b"READY=1\nWATCHDOG=1", "\0" + path[1:] if path.startswith("@") else path)
        except OSError:
            return  # a manager that does not read must not stop the loop
