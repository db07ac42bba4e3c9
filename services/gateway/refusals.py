"""Who was refused at the radio's door, and who inside tried what they may not: Zenoh says so only in its log.

The access rules' part of it is a line for each message that passes, and says of each key, when it is first met, all that
may not be done with it; of these lines only those are counted that tell of a deed.
"""

import re
from collections import Counter

from schemas.topics import SERVICES, TOPICS
from services.gateway.access import ALIVE

_ACCESS = "zenoh::net::routing::interceptor::access_control"
_REASON = re.compile(r'reason: "([^"]+)"')
_GIVEN_UP = re.compile(r"ConnectionClosed|ApplicationClosed|LocallyClosed|TimedOut|Reset")  # by whom a radio cut off
_FROM_LINK = re.compile(r"WARN .*zenoh_link_\w+\S*: (.*)")
_FIRST_MET = re.compile(r"(ThreadId\(\d+\)) \S+ ACL \(ingress\): caching permissions for `(.*)`")
_REFUSED = re.compile(
    r"(ThreadId\(\d+\)) \S+ (Using cached result: )?(\w+)(?: on (\S+))? is unauthorized to "
    r"(Put|Delete|Liveliness Token) \(ingress\) on (.*)"
)
_NAME = re.compile(r"CertCommonName\(([^)]*)\)")
_DEEDS = {"Put": "put", "Delete": "delete", "Liveliness Token": "token"}
_SESSIONS_REMEMBERED = 1000


class Refusals:
    """Counts both. `note` is called in the log's own thread."""

    levels = f"error,zenoh_link_tls=warn,zenoh_link_commons=warn,{_ACCESS}=trace"

    def __init__(self, prefix: str) -> None:
        self.sessions = 0
        self.denied: Counter[str] = Counter()
        """How often, by deed, key and the certificate's name."""
        self._prefix = prefix
        self._why = self._who = ""
        self._known = {topic.key for topic in TOPICS} | {ALIVE + service for service in SERVICES}
        self._subjects: dict[str, str] = {}
        """Of each session, as the rules know it: the first, where it has several links, because each link has its line."""
        self._first_met: dict[str, tuple[str, set[str]]] = {}
        """By thread: the key whose permissions it looks up, and for which deeds that is still to be said."""

    def note(self, line: str) -> bool:
        """Look at one line of the log; returns whether it is to be printed."""
        if f" {_ACCESS}: " in line:
            if "caching" in line:
                self._meet(line)
            elif "unauthorized" in line:
                self._deny(line)
            return False
        found = _FROM_LINK.search(line)
        if found and not _GIVEN_UP.search(found[1]):
            self.sessions += 1
            said = found[1].split(" Hint")[0].strip(" .")
            reason = _REASON.search(said)  # QUIC's, among much else
            self._why = reason[1] if reason else said
        return True

    def __str__(self) -> str:
        sessions = f"{self.sessions} sessions refused ({self._why})" if self.sessions else ""
        denied = f"{sum(dict(self.denied).values())} times denied ({self._who})" if self._who else ""
        return "; ".join(filter(None, (sessions, denied)))

    def _meet(self, line: str) -> None:
        if found := _FIRST_MET.search(line):
            self._first_met[found[1]] = found[2], {"Put", "Delete"}

    def _deny(self, line: str) -> None:
        if not (found := _REFUSED.search(line)):
            return
        thread, met_before, session, subject, deed, key = found.groups()
        if subject and subject != self._subject_of(session, subject):
            return
        met, to_be_said = self._first_met.get(thread, ("", set[str]()))
        if not met_before and met == key and deed in to_be_said:
            to_be_said.remove(deed)
            return
        name = _NAME.search(self._subjects.get(session, ""))
        key = key.removeprefix(self._prefix)
        self._who = (
            f"{_DEEDS[deed]} {key if key in self._known else 'another key'} by {name[1] if name else 'somebody'}"
        )
        self.denied[self._who] += 1

    def _subject_of(self, session: str, subject: str) -> str:
        if len(self._subjects) >= _SESSIONS_REMEMBERED:
            self._subjects.clear()
        return self._subjects.setdefault(session, subject)
