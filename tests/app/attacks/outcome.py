"""What an attack did, what happened, and whether the server held."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field

import httpx


@dataclass
class Outcome:
    """did, happened : sentences; broken : a sentence for each promise that was not kept; empty: the server held"""

    name: str
    did: list[str] = field(default_factory=list)
    happened: list[str] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    statuses: Counter[int] = field(default_factory=Counter)

    def expect(self, held: bool, otherwise: str) -> bool:
        """Note `otherwise` as broken where a promise is not `held`; whether it is."""
        if not held:
            self.broken.append(otherwise)
        return held

    def answered(self, what: str, answer: httpx.Response, among: Iterable[int] | None = None) -> httpx.Response:
        """Count an answer; broken where it is a fault of the server, or not one of those that were expected."""
        status = answer.status_code
        self.statuses[status] += 1
        wrong = status >= 500 if among is None else status not in among
        self.expect(not wrong, f"{what}: {status} {_detail(answer)!r}")
        return answer

    def __str__(self) -> str:
        lines = [f"{self.name}: {'BROKEN' if self.broken else 'HELD'}"]
        lines += [f"    did       {line}" for line in self.did]
        lines += [f"    happened  {line}" for line in self.happened]
        if self.statuses:
            lines.append("    answers   " + ", ".join(f"{n} × {status}" for status, n in sorted(self.statuses.items())))
        counted = Counter(self.broken)
        shown = list(counted.items())[:60]
        lines += [f"    broken    {line}" + (f" ({count} times)" if count > 1 else "") for line, count in shown]
        if len(counted) > len(shown):
            lines.append(f"    broken    and {len(counted) - len(shown)} more")
        return "\n".join(lines)


def _detail(answer: httpx.Response) -> str:
    """What a problem says, or the beginning of any other answer."""
    with suppress(ValueError, KeyError, TypeError):
        return str(answer.json()["detail"])[:200]
    return answer.content[:120].decode("utf-8", "replace")
