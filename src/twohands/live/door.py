"""Who may see the page and the stream: any web site that a user looks at could try to.

A browser says in `Origin` which page opens a WebSocket, and in `Host` by which name it has found us. On this machine
alone, both must be ours; a name of somebody else that leads to 127.0.0.1 is none. Where others may come, they need the
token. Programs that are no browsers send no `Origin`.
"""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final
from urllib.parse import urlsplit

from twohands.errors import InputError

LOOPBACK: Final = "127.0.0.1"
_LOCAL_NAMES: Final = (LOOPBACK, "localhost", "[::1]")
MIN_TOKEN_LENGTH: Final = 8


@dataclass(frozen=True, slots=True)
class Door:
    """The rules.

    Attributes:
        port: on which the server listens.
        token: what everybody must say; None where only this machine can come.
        origins: of pages that are let in besides our own, such as "http://localhost:3000".
    """

    port: int
    token: str | None = None
    origins: tuple[str, ...] = ()

    def refusal(self, headers: Mapping[str, str], token: str | None) -> str | None:
        """Why a request is refused; None where it is let in.

        Args:
            headers: of the request, names in small letters.
            token: that it says.
        """
        host, origin = headers.get("host", ""), headers.get("origin")
        if self.token is not None and not hmac.compare_digest((token or "").encode(), self.token.encode()):
            return "the token is missing or wrong"
        if self.token is None and host not in self._local():
            return "another host name than this machine's own"
        if origin is not None and origin not in (*self.origins, f"http://{host}", f"https://{host}"):
            return f"pages of another origin are refused ({origin[:80]}); see --allow-origin"
        return None

    def _local(self) -> set[str]:
        return {f"{name}:{self.port}" for name in _LOCAL_NAMES} | (set(_LOCAL_NAMES) if self.port == 80 else set())


def check_door(host: str, token: str | None, origins: tuple[str, ...]) -> None:
    """See whether an address may be opened like that.

    Raises:
        InputError: others could come without a token, the token is too short, or an origin is none.
    """
    if host != LOOPBACK and token is None:
        raise InputError(
            f"--host {host} lets others in: give them a --token of at least {MIN_TOKEN_LENGTH} letters and digits"
        )
    if token is not None and not (len(token) >= MIN_TOKEN_LENGTH and token.isascii() and token.isalnum()):
        raise InputError(f"--token must be at least {MIN_TOKEN_LENGTH} letters and digits")
    for origin in origins:
        parts = urlsplit(origin)
        if parts.scheme not in ("http", "https") or not parts.netloc or origin != f"{parts.scheme}://{parts.netloc}":
            raise InputError(f"--allow-origin {origin}: an origin such as http://localhost:3000 expected")
