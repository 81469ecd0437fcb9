"""A tester that asks all the time, and is answered within P2, whatever else happens."""

from gateway.bus.frames import empty, put

MS = 1_000_000
P2_NS = 50 * MS
#: A segmented answer goes on within this time (ISO 15765-2, N_Cr) [ns].
REST_NS = 1000 * MS
REQUEST, RESPONSE = 0x7E0, 0x7E8
FLOW_CONTROL = bytes.fromhex("300000cccccccccc")
CLEAR = bytes.fromhex("14ffffff")
REQUESTS = (bytes.fromhex("3e00"), bytes.fromhex("1902ff"), bytes.fromhex("1902ff"))


class Tester:
    """Asks one thing after another on one bus.

    Args:
        bench: of the run.
        uri: of the bus.
        rng: draws what is asked.
        clearing: percent of requests that clear the memory.

    Attributes:
        asked, answered, excused: requests; the last are those that the bus itself kept from coming or going.
        longest_ns: longest time to an answer.
    """

    def __init__(self, bench, uri, rng, *, clearing=2):
        self._bench, self._uri, self._rng, self._clearing = bench, uri, rng, clearing
        self._request = None
        self._asked_ns = self._stalled_ns = self._next_ns = 0
        self._missing = 0  # bytes of a segmented answer
        self._begun = self._excused = False
        self._control = False
        self.asked = self.answered = self.excused = 0
        self.longest_ns = 0
        self.refused = []

    def excuse(self):
        """What is under way may fail: the bus does not carry it."""
        self._excused = True

    @property
    def clears(self):
        """Whether a clear is under way."""
        return self._request == CLEAR

    @property
    def _kept_from(self):
        return self._uri in self._bench.cut or self._uri in self._bench.room

    def turn(self):
        """Ask, or see whether it is time for an answer; returns what is wrong, None if nothing is."""
        bench = self._bench
        if self._kept_from:
            self.excuse()
        if self._begun and bench.stalled_ns - self._stalled_ns >= REST_NS // 2:
            self.excuse()  # the gateway gave up: its own time passed while it could not read the flow control
        if self._control:
            self._control = False
            self._put(FLOW_CONTROL)
        if self._request is None:
            if bench.now_ns >= self._next_ns and self._uri in bench.wires:
                self._ask()
            return None
        waited = self._waited()
        if waited <= (REST_NS if self._begun or self._excused or self._request == CLEAR else P2_NS):
            return None
        excused, request = self._excused, self._request
        self._end(answered=False)
        if excused or request == CLEAR:
            return None
        return f"{request.hex()} was not answered within {waited / 1e6:.1f} ms"

    def _waited(self):
        return self._bench.now_ns - self._asked_ns - (self._bench.stalled_ns - self._stalled_ns)

    def _ask(self):
        self._request = CLEAR if self._rng.random() * 100 < self._clearing else self._rng.choice(REQUESTS)
        self._begun, self._excused, self._missing = False, self._kept_from, 0
        self._restart()
        self.asked += 1
        length = len(self._request)
        self._put(bytes([length]) + self._request + bytes(7 - length))

    def _restart(self):
        self._asked_ns, self._stalled_ns = self._bench.now_ns, self._bench.stalled_ns

    def _put(self, data):
        frames = empty(1)
        put(frames, 0, self._bench.now_ns, REQUEST, data)
        self._bench.put(self._uri, frames)

    def take(self, data):
        """Take a frame of the gateway's answer; returns what is wrong with it, None if nothing is."""
        if self._request is None:
            return None  # of a request that was given up, or came twice
        kind = data[0] >> 4
        if kind == 2 and self._begun:
            self._missing -= 7
            if self._missing <= 0:
                self._end(answered=True)
            return None
        if kind not in (0, 1):
            return None
        service = self._request[0]
        found = data[1 : 1 + data[0]] if kind == 0 else data[2:]
        if found[0] == 0x7F and found[1] == service and found[2] == 0x78:
            self._begun = True
            self._restart()
            return None
        if found[0] not in (service + 0x40, 0x7F):
            return None if self._excused else f"{self._request.hex()} was answered {found.hex()}"
        if not self._excused and self._request != CLEAR:
            self.longest_ns = max(self.longest_ns, self._waited())
        if kind == 1:
            self._begun, self._control = True, True
            self._missing = ((data[0] & 0x0F) << 8 | data[1]) - 6
            self._restart()
            return None
        if found[0] == 0x7F:
            self.refused.append(found.hex())
        self._end(answered=True)
        return None

    def _end(self, *, answered):
        self.answered += answered
        self.excused += not answered
        self._request = None
        self._next_ns = self._bench.now_ns + self._rng.randrange(5, 60) * MS
