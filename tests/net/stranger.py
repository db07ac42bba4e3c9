"""Somebody else on the bus: a bare Zenoh session that tries what its orders say and prints what it sees, as JSON.

`python -m tests.net.stranger ORDERS.json`. Orders: `settings` for the session, `subscribe` keys, `put` [key, text], packed
as the topic is, or [key, bytes to make up], `delete` keys, `token` and `query` keys, `many` distinct keys under `base`, and
`seconds` to stay, putting ten times a second.
"""

import json
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import zenoh

from schemas.topics import BY_KEY
from services.runtime.packing import packer

PREFIX = "clew/@v1/t/"
SCOUTING = {"scouting/multicast/enabled": False, "scouting/gossip/enabled": False, "connect/timeout_ms": 1500}


def main() -> None:
    """As the module says."""
    orders: dict[str, Any] = json.loads(Path(sys.argv[1]).read_text())
    config = zenoh.Config()
    for key, value in ({"mode": "client", "connect/exit_on_failure": True} | SCOUTING | orders["settings"]).items():
        config.insert_json5(key, json.dumps(value))
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        print(json.dumps({"open": False, "why": str(error)}), flush=True)
        return
    with session:
        print(json.dumps({"open": True} | _try(session, orders)), flush=True)


def _try(session: zenoh.Session, orders: dict[str, Any]) -> dict[str, Any]:
    heard: Counter[str] = Counter()
    for key in orders.get("subscribe", []):
        session.declare_subscriber(key, lambda sample: heard.update([str(sample.key_expr)]))
    tokens = [session.liveliness().declare_token(key) for key in orders.get("token", [])]
    puts = [(key, b"x" * what if isinstance(what, int) else _packed(key, what)) for key, what in orders.get("put", [])]
    began = time.monotonic()
    for n in range(orders.get("many", 0)):
        session.put(f"{orders['base']}/k{n}", b"x")
    while time.monotonic() - began < orders["seconds"]:
        for key, payload in puts:
            session.put(key, payload, congestion_control=zenoh.CongestionControl.DROP)
        for key in orders.get("delete", []):
            session.delete(key)
        time.sleep(0.1)
    answers = [
        str(reply.ok.key_expr)
        for key in orders.get("query", [])
        for reply in session.get(key, timeout=1.0)
        if reply.ok is not None
    ]
    linked = len(list(session.info.routers_zid()))
    return {"heard": dict(heard), "answers": answers, "tokens": len(tokens), "routers": linked}


def _packed(key: str, text: str) -> bytes:
    topic = BY_KEY.get(key.removeprefix(PREFIX))
    return packer(topic)(text.encode()) if topic and topic.packed else text.encode()


if __name__ == "__main__":
    main()
