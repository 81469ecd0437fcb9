"""Sockets of a door that listens: without descriptors all of them rest, and the loop sleeps."""

import errno
import selectors
import socket

from gateway.live.listening_sockets import REST_S, ListeningSockets


class Listener(socket.socket):
    """Has no descriptor left for a connection while ``full``."""

    full = False

    def accept(self):
        if Listener.full:
            raise OSError(errno.EMFILE, "no descriptors")
        return super().accept()


def test_two_sockets_rest_where_one_finds_no_descriptors_and_listen_again(monkeypatch):
    with selectors.DefaultSelector() as selector:
        listening = ListeningSockets(selector, "not taken")
        made = [Listener(socket.AF_INET, socket.SOCK_STREAM) for _ in range(2)]
        for k, each in enumerate(made):
            each.bind(("127.0.0.1", 0))
            each.listen()
            each.setblocking(False)
            listening.add(each, k)
        testers = [socket.create_connection(each.getsockname(), timeout=10) for each in made]

        def ready():
            return sorted(key.data for key, _ in selector.select(0))

        monkeypatch.setattr(Listener, "full", True)
        assert ready() == [0, 1]
        listening.turn(5.0)
        assert [listening.accept(each) for each in made] == [None, None], "the second is asked in the same turn"
        assert ready() == [], "the loop would turn for nothing"
        listening.turn(5.0 + REST_S / 2)
        assert ready() == []
        monkeypatch.setattr(Listener, "full", False)
        listening.turn(5.0 + REST_S)
        assert ready() == [0, 1]
        for each, tester in zip(made, testers, strict=True):
            taken, peer = listening.accept(each)
            assert peer == tester.getsockname()
            assert taken.gettimeout() == 0.0, "it never waits"
            assert listening.accept(each) is None
            taken.close()
            tester.close()
        for each in made:
            each.close()
