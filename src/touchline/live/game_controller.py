"""What the referee's GameController broadcasts over UDP, twice a second; nothing is sent back.

Little-endian and packed; the header is "RGme". The version tells who sends it (18: Standard Platform League; 19, 20:
Humanoid Soccer League), and how many bytes each of 20 players of a team has; so does the length, and both must agree.
"""

from collections import Counter

from touchline.live.heard import Heard, Link, Published, count_refused
from touchline.live.udp import bound, received
from touchline.types import GameState
from touchline.types.game import PHASES, STAYS

PORT = 3838
HEADER, PLAYERS = b"RGme", 20
PHASE, FIRST_HALF, TEAMS = 10, 12, 18  # offsets of bytes
OF_TEAM = 10  # bytes before its players
PLAYER_BYTES = {18: 2, 19: 4, 20: 3}
STANDBY = 5  # of version 18: before READY, at the places of INITIAL
_HSL = "illegal positioning", STAYS
_HSL_FIELD = (
    *("local game stuck", "incapable robot", "picked up", "ball holding", "leaving the field"),
    *("playing with arms or hands", "pushing"),
)
_SPL = (
    *("illegal ball contact", "pushing", STAYS, "inactive", "illegal position", "leaving the field", "picked up"),
    *("local game stuck", "illegal position in set", "stance", STAYS),
)
PENALTIES = {
    18: dict(enumerate(_SPL, 1)) | {14: "substitute", 15: "manual"},
    19: dict(enumerate((*_HSL, *_HSL_FIELD, "sent off", "substitute"), 1)),
    20: dict(enumerate((*_HSL, STAYS, *_HSL_FIELD, "cautioned", "sent off", "substitute"), 1)),
}


def length_of(version: int) -> int:
    """Bytes of a packet."""
    return TEAMS + 2 * (OF_TEAM + PLAYERS * PLAYER_BYTES[version])


class GameController:
    """Packets to what they say to one robot. team, player: its numbers; None: of no robot, so without penalties."""

    def __init__(self, team: int | None = None, player: int | None = None) -> None:
        self.team, self.player = team, player
        self.refused: Counter[str] = Counter()

    def read(self, packet: bytes, stamp_ns: int) -> GameState | None:
        """What a packet says; None if nothing that can be used, which is counted."""
        version = packet[4] if packet[:4] == HEADER and len(packet) > 4 else None
        if version is None:
            count_refused(self.refused, "a packet that is none of the GameController")
        elif version not in PLAYER_BYTES:
            known = ", ".join(map(str, PLAYER_BYTES))
            count_refused(self.refused, f"a GameController packet of version {version}; known: {known}")
        elif len(packet) != length_of(version):
            what = f"a GameController packet of version {version} with {len(packet)} bytes, not {length_of(version)}"
            count_refused(self.refused, what)
        elif packet[PHASE] >= len(PHASES) and packet[PHASE] != STANDBY:
            count_refused(self.refused, f"a GameController packet with the state {packet[PHASE]}")
        else:
            phase = "initial" if packet[PHASE] == STANDBY else PHASES[packet[PHASE]]
            penalty = self._penalty(packet, version)
            return None if penalty is None else GameState(stamp_ns, phase, penalty, packet[FIRST_HALF] == 1)
        return None

    def _penalty(self, packet: bytes, version: int) -> str | None:
        """In words; None where its team does not play."""
        if self.team is None or self.player is None:
            return ""
        size = PLAYER_BYTES[version]
        for at in (TEAMS, TEAMS + OF_TEAM + PLAYERS * size):
            if packet[at] == self.team:
                number = packet[at + OF_TEAM + size * (self.player - 1)]
                return PENALTIES[version].get(number, f"penalty {number}") if number else ""
        count_refused(self.refused, f"a GameController packet of other teams than {self.team}")
        return None


class WithGameController:
    """A link and the referee as one link. What the referee says is stamped as the newest of what the link brought."""

    def __init__(self, link: Link, controller: GameController, here: tuple[str, int] = ("", PORT)) -> None:
        """Raises InputError for an address that can't be listened at."""
        self._link, self._controller = link, controller
        self._in = bound(here, shared=True)
        self._stamp_ns, self._silent = 0, True

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens."""
        host, port = self._in.getsockname()
        return str(host), int(port)

    def hear(self, timeout_s: float) -> list[Heard]:
        """What the link brings, and what the referee says."""
        found = self._link.hear(timeout_s)
        self._stamp_ns = max((self._stamp_ns, *(getattr(heard, "stamp_ns", 0) for heard in found)))
        packets = list(received(self._in, 0.0))
        self._silent = self._silent and not packets
        said = (self._controller.read(packet, self._stamp_ns) for packet in packets)
        return [*found, *(state for state in said if state is not None)]

    def publish(self, published: Published) -> None:
        """As the link does: nothing is sent to the referee."""
        self._link.publish(published)

    @property
    def refused(self) -> dict[str, int]:
        """As the link has it, packets that could not be used, and that none came at all."""
        silent = {f"no packet of the GameController on UDP port {self.address[1]}": 1} if self._silent else {}
        return {**self._link.refused, **self._controller.refused, **silent}

    def around(self) -> str:
        """As the link says."""
        return self._link.around()

    def close(self) -> None:
        """Let go of both."""
        self._in.close()
        self._link.close()
