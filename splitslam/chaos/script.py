"""What happens when: a line `SECONDS VERB TARGET [FOR_S]` each, or a key pressed meanwhile."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from splitslam.errors import InputError

# verb and target -> how long it lasts by default, s. 0: over at once, the supervisor starts it again.
HARMS = {
    "kill replica": 0.0,
    "freeze replica": 6.0,
    "drain replica": 0.0,
    "kill store": 3.0,
    "kill proxy": 0.0,
    "kill agent": 0.0,
    "cut network": 6.0,
}
KEYS = {"k": "kill replica", "s": "kill store", "n": "cut network", "a": "kill agent"}
DEFAULT = """
 4   kill replica
 9   kill agent
20   kill store     3
28   cut network    6
"""


@dataclass(frozen=True, slots=True)
class Harm:
    """One thing that is done: what (a key of HARMS), when after the drive's begin, and for how long."""

    at_s: float
    what: str
    for_s: float


def read_script(name: str) -> tuple[Harm, ...]:
    """`default` or the path of a file. Raises InputError that names file, line and what was expected."""
    if name == "default":
        return parse(DEFAULT, "default")
    try:
        return parse(Path(name).read_text(encoding="utf-8"), name)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"--script {name}: expected `default` or a text file ({error})") from None


def parse(text: str, name: str) -> tuple[Harm, ...]:
    """In order of time. # starts a comment. Raises InputError."""
    harms = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        what = " ".join(words[1:3])
        if what not in HARMS or len(words) > 4:
            known = ", ".join(HARMS)
            raise InputError(f"{name}:{number}: expected SECONDS, one of {known}, and how long; found {line.strip()!r}")
        try:
            at_s, for_s = float(words[0]), float(words[3]) if len(words) == 4 else HARMS[what]
        except ValueError:
            raise InputError(f"{name}:{number}: expected seconds as a number, found {line.strip()!r}") from None
        if not (at_s >= 0.0 and 0.0 <= for_s < 600.0):
            raise InputError(f"{name}:{number}: expected seconds from 0 on, found {line.strip()!r}")
        harms.append(Harm(at_s, what, for_s))
    return tuple(sorted(harms, key=lambda harm: harm.at_s))
