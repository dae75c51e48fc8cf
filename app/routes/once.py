"""How is a call made again without being done again? By its `Idempotency-Key`, which is asked for here by all calls but
uploads, which have theirs read from the form's request."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Header, Request
from pydantic import BaseModel
from pydantic_core import PydanticSerializationError

from app.problems import NESTED_TOO_DEEPLY, HttpProblem
from app.store.idempotency import Call, IdempotencyKeys, call_key

SAFE_TO_REPEAT = "makes the call safe to repeat for a day: the same key and content give the same answer"


@dataclass(frozen=True)
class CallOnce:
    """A call as it came. key : of `call_key`"""

    keys: IdempotencyKeys
    key: str | None

    def made(self, body: BaseModel, make: Callable[[Call | None], dict[str, Any]]) -> dict[str, Any]:
        """What `make` answers, which lets an entry land as the answer to the call that it is given; or the answer to
        the call before with the same key. Raises HttpProblem as `IdempotencyKeys.once`."""
        return self.keys.once(self.key, _fingerprint(body), make)

    def done(self, body: BaseModel | None, act: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """What `act` answers, which makes no entry; likewise."""
        return self.keys.once(self.key, _fingerprint(body), lambda call: self.keys.command(call, act))


def _call_once(
    request: Request, idempotency_key: Annotated[str | None, Header(description=SAFE_TO_REPEAT)] = None
) -> CallOnce:
    call = f"{request.method} {request.url.path}"
    return CallOnce(request.app.state.store.idempotency, call_key(call, idempotency_key))


Once = Annotated[CallOnce, Depends(_call_once)]


def _fingerprint(body: BaseModel | None) -> str:
    """Of what was said, not of what stands for what was left out: a `reset` tells the two apart."""
    try:
        text = "{}" if body is None else body.model_dump_json(exclude_unset=True)
    except PydanticSerializationError:
        raise HttpProblem(400, NESTED_TOO_DEEPLY) from None
    return hashlib.sha256(text.encode()).hexdigest()
