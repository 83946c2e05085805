"""Packets sent by UDP: all of them, in order, each at its time, and counts of what went wrong."""

from __future__ import annotations

import errno
import math
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lidarsim as ls
from lidarsim.cli import main
from lidarsim.cli.printing import print_sent
from lidarsim.io import packets
from lidarsim.io.packets import Packet, Sender, _format, _udp
from tests.io.packets import toy

START = 1_577_836_800.0  # 2020-01-01T00:00:00Z


@pytest.fixture(autouse=True)
def _with_toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(_format._formats, toy.MODEL, toy.TOY)


def room() -> ls.Scene:
    scene = ls.Scene()
    scene.add(ls.Sphere((0.0, 0.5, 0.0), 4.0))
    return scene


class Receiver:
    """Collect what arrives at a free port of the loopback interface, by address of the sender."""

    def __init__(self, family: socket.AddressFamily = socket.AF_INET, port: int = 0) -> None:
        self.socket = socket.socket(family, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.socket.bind(("::1" if family == socket.AF_INET6 else "127.0.0.1", port))
        self.port = self.socket.getsockname()[1]
        self.payloads: list[bytes] = []
        self.thread = threading.Thread(target=self._receive)

    def _receive(self) -> None:
        while (payload := self.socket.recv(1 << 16)) != b"end":
            self.payloads.append(payload)

    def __enter__(self) -> Receiver:
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with socket.socket(self.socket.family, socket.SOCK_DGRAM) as sender:
            sender.sendto(b"end", self.socket.getsockname())  # behind all others, since loopback keeps the order
        self.thread.join()
        self.socket.close()


class Clock:
    """A clock that only sleeping, and each packet sent, moves."""

    def __init__(self, sender: Sender, *, each: float = 0.0) -> None:
        self.now, self.each = 100.0, each
        self.sent: list[tuple[float, Packet]] = []
        self.slept: list[float] = []
        sender._clock, sender._sleep = (lambda: self.now), self.sleep
        sender._send = self.send  # type: ignore[method-assign]

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds

    def send(self, packet: Packet) -> None:
        self.sent.append((self.now, packet))
        self.now += self.each


def rows_of(scans: list[ls.Scan], start: float = START) -> list[tuple[int, int, int, list[float]]]:
    """Time, frame, first pulse and ranges of each packet, from the arrays of the scans."""
    rows = [
        (round(start * 1e9) + round((scan.time + float(t)) * 1e9), scan.frame, k, float(np.float32(r)))
        for scan in scans
        for k, (t, r) in enumerate(zip(scan.pulses.time, scan.range[:, 0], strict=True))
    ]
    groups = [rows[i : i + toy.PULSES] for i in range(0, len(rows), toy.PULSES)]
    return [(group[-1][0], group[0][1], group[0][2], [row[3] for row in group]) for group in groups]


def test_all_packets_arrive_in_order() -> None:
    lidar = toy.lidar()
    scans = list(lidar.frames(room(), None, 7))
    with Receiver() as receiver, Sender(lidar, f"127.0.0.1:{receiver.port}", fast=True) as sender:
        sent = sender.send(scans)
    got = [toy.content(payload) for payload in receiver.payloads]
    assert len(got) == 18  # 7 frames of 25 pulses, ten a packet, and the last with five
    assert [(c.time, c.frame, c.first, c.range) for c in got] == rows_of(scans)
    assert {c.port for c in got} == {receiver.port} == sent.ports
    assert (sent.packets, sent.dropped, sent.lag) == (18, 0, 0.0)
    assert sent.size == sum(map(len, receiver.payloads))


def test_host_names_are_resolved() -> None:
    family = socket.getaddrinfo("localhost", 9, type=socket.SOCK_DGRAM)[0][0]
    lidar = toy.lidar()
    with Receiver(family) as receiver, Sender(lidar, f"localhost:{receiver.port}", fast=True) as sender:
        sender.send(lidar.frames(room(), None, 2))
    assert len(receiver.payloads) == 5


@pytest.mark.parametrize(
    ("to", "host", "port"),
    [
        ("192.168.1.10", "192.168.1.10", None),
        ("host.example:2368", "host.example", 2368),
        ("::1", "::1", None),
        ("[::1]", "::1", None),
        ("[fe80::1%eth0]:65535", "fe80::1%eth0", 65535),
    ],
)
def test_addresses_of_every_kind(to: str, host: str, port: int | None) -> None:
    assert _udp._parse(to) == (host, port)


def test_ipv6_keeps_its_scope(monkeypatch: pytest.MonkeyPatch) -> None:
    there = ("fe80::1", 9, 0, 3)
    monkeypatch.setattr(_udp, "_reachable", lambda *_: (socket.AF_INET, there))
    lidar, taken = toy.lidar(), Full([0] * 5)
    with Sender(lidar, "[fe80::1%eth0]:4000", fast=True) as sender:
        sender._socket.close()
        sender._socket = taken  # type: ignore[assignment]
        sender.send(lidar.frames(room(), None, 2))
    assert taken.addresses == [("fe80::1", 4000, 0, 3)] * 5


def test_sensors_of_a_rig_send_in_order_of_time_to_ports_of_their_own() -> None:
    rig = ls.Rig({"top": (toy.lidar(20), None), "left": (toy.lidar(40, rate=50.0), None, 0.0012)})
    with Sender(rig, "127.0.0.1:4000") as sender:
        clock = Clock(sender)
        sender.send(rig.frames(room(), None, 4))
    assert [packet.time for _, packet in clock.sent] == sorted(packet.time for _, packet in clock.sent)
    ports = [packet.port for _, packet in clock.sent]
    assert (ports.count(4000), ports.count(4002)) == (8, 8)


def test_each_packet_waits_for_its_time() -> None:
    lidar = toy.lidar()
    with Sender(lidar) as sender:
        clock = Clock(sender)
        sent = sender.send(lidar.frames(room(), None, 3))
    first = clock.sent[0][1].time
    assert clock.sent[0][0] == 100.0  # the first one does not wait
    since = [(packet.time - first) / 1e9 for _, packet in clock.sent]
    # `now + (due - now)` may differ from `due` by the rounding of either: 2 ulps of a number near 100.
    np.testing.assert_allclose([now - 100.0 for now, _ in clock.sent], since, rtol=0, atol=2 * math.ulp(100.0))
    assert len(clock.slept) == len(clock.sent) - 1 == 7
    assert sent.span == since[-1]
    assert sent.lag <= 2 * math.ulp(100.0)


def test_late_packets_are_sent_at_once_and_the_lag_is_told() -> None:
    lidar = toy.lidar()  # a packet every 4 ms
    with Sender(lidar) as sender:
        clock = Clock(sender, each=0.005)
        sent = sender.send(lidar.frames(room(), None, 4))
    assert clock.slept == []
    assert len(clock.sent) == 10
    lag = clock.sent[-1][0] - 100.0 - sent.span  # each packet takes 1 ms longer than there is
    assert lag > 0.008
    assert sent.lag == pytest.approx(lag, abs=4 * math.ulp(100.0))


def test_fast_never_waits() -> None:
    lidar = toy.lidar()
    with Sender(lidar, fast=True) as sender:
        clock = Clock(sender)
        sender.send(lidar.frames(room(), None, 3))
    assert len(clock.sent) == 8
    assert clock.slept == []


def test_repetitions_go_on_in_time_and_number() -> None:
    lidar = toy.lidar(20)
    scans = list(lidar.frames(room(), None, 2, first=3))
    with Sender(lidar) as sender:
        clock = Clock(sender)
        sender.send(lambda: scans, repeat=3, period=0.02)
    contents = [toy.content(packet.payload) for _, packet in clock.sent]
    assert [c.frame for c in contents] == [3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 8]
    assert set(np.diff([c.time for c in contents])) <= {4_999_999, 5_000_000, 5_000_001}  # each is rounded to 1 ns


@pytest.mark.parametrize(
    ("model", "cycles", "period"),  # firing cycles of a packet, and the time from one to the next, us
    [
        ("velodyne-vlp16", 24, 55.296),
        ("velodyne-hdl32e", 12, 46.08),
        ("livox-mid360", 24, 20.0),
        ("hesai-pandar40p", 10, 55.56),
        ("hesai-xt32m2x", 6, 50.0),
    ],
)
@pytest.mark.parametrize(("first", "count"), [(0, 1), (0, 2), (3, 1), (1, 2)])
def test_packets_go_on_where_repetitions_meet(model: str, cycles: int, period: float, first: int, count: int) -> None:
    lidar = ls.Lidar.preset(model)
    scans = list(lidar.frames(room(), None, count, first=first))
    with Sender(lidar, fast=True) as sender:
        clock = Clock(sender)
        sender.send(lambda: scans, repeat=3, period=count / 10.0)
    port = clock.sent[0][1].port
    times = np.array([packet.time for _, packet in clock.sent if packet.port == port])
    # A frame begins with the first cycle in it and ends with the last, so the cycles on both sides of a seam are less
    # than two periods apart. A padded packet would end up to its whole length later.
    steps = np.diff(times) / 1e3
    assert np.abs(steps - cycles * period).max() < period + 0.004
    whole = 3 * sum(len(scan) for scan in scans) // np.unique(scans[0].pulses.ring).size / cycles
    assert len(times) == math.ceil(whole)


def test_sequence_numbers_go_on_where_repetitions_meet() -> None:
    lidar = ls.Lidar.preset("hesai-xt32")
    scan = lidar.scan(room())
    with Sender(lidar, fast=True) as sender:
        clock = Clock(sender)
        sender.send(lambda: [scan], repeat=3, period=0.1)
    numbers = [int.from_bytes(packet.payload[-4:], "little") for _, packet in clock.sent]
    assert numbers == list(range(1, 3 * 250 + 1))


def test_a_few_frames_are_scanned_ahead() -> None:
    lidar = toy.lidar(20)
    taken = 0
    ahead = threading.Event()

    def scans() -> Iterator[ls.Scan]:
        nonlocal taken
        for scan in lidar.frames(room(), None, 50):
            taken += 1
            if taken == 4:  # of the one being sent, two that wait, and one that is being scanned
                ahead.set()
            yield scan

    sent: list[int] = []

    def send(_: Packet) -> None:
        if not sent:
            assert ahead.wait(60.0)
            time.sleep(0.2)  # in which a thread that does not stop would go on
        sent.append(taken)

    with Sender(lidar) as sender:
        Clock(sender)
        sender._send = send  # type: ignore[method-assign]
        sender.send(scans())
    assert len(sent) == 100
    assert sent[0] == 4
    assert max(taken - k // 2 for k, taken in enumerate(sent)) <= 4


def test_the_thread_ends_when_sending_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    lidar = toy.lidar()

    def fail(_: Packet) -> None:
        raise KeyboardInterrupt

    with Sender(lidar) as sender:
        monkeypatch.setattr(sender, "_send", fail)
        with pytest.raises(KeyboardInterrupt):
            sender.send(lambda: lidar.frames(room(), None, 5), repeat=math.inf, period=0.05)
    assert not any(thread.name.startswith("lidarsim-scan-ahead") for thread in threading.enumerate())


def test_errors_while_scanning_are_raised() -> None:
    lidar = toy.lidar()

    def scans() -> Iterator[ls.Scan]:
        yield lidar.scan(room())
        raise RuntimeError("broken")

    with Sender(lidar, fast=True) as sender, pytest.raises(RuntimeError, match="broken"):
        sender.send(scans())
    assert sender.sent.packets == 2


class Full:
    """A socket whose buffer is full for some packets."""

    def __init__(self, failures: list[int]) -> None:
        self.failures = iter(failures)
        self.addresses: list[tuple[Any, ...]] = []

    def sendto(self, _: bytes, address: tuple[Any, ...]) -> None:
        self.addresses.append(address)
        if number := next(self.failures):
            raise OSError(number, "Network is out of buffers")

    def close(self) -> None:
        pass


def test_refused_packets_are_counted() -> None:
    lidar = toy.lidar()
    with Sender(lidar, fast=True) as sender:
        sender._socket.close()
        sender._socket = Full([0, errno.ENOBUFS, 0, errno.EAGAIN, 0])  # type: ignore[assignment]
        sent = sender.send(lidar.frames(room(), None, 2))
    assert (sent.packets, sent.dropped) == (3, 2)


def test_a_network_that_goes_down_is_told() -> None:
    lidar = toy.lidar()
    with Sender(lidar, fast=True) as sender:
        sender._socket.close()
        sender._socket = Full([0, errno.ENETDOWN])  # type: ignore[assignment]
        with pytest.raises(OSError, match=r"to: 127\.0\.0\.1: cannot be sent to: Network is out of buffers"):
            sender.send(lidar.frames(room(), None, 2))


def test_metadata(tmp_path: Path) -> None:
    with Sender({"top": toy.lidar(), "left": toy.lidar()}) as sender:
        assert sender.save_metadata(tmp_path / "rig.json") == [tmp_path / "rig_top.json", tmp_path / "rig_left.json"]
    assert (tmp_path / "rig_left.json").read_bytes() == b"{}"


@pytest.mark.parametrize(
    ("to", "message"),
    [
        ("", "to: expected HOST, HOST:PORT or [IPV6]:PORT, such as 127.0.0.1:7502, got ''"),
        (":7502", "to: expected HOST, HOST:PORT or [IPV6]:PORT, such as 127.0.0.1:7502, got ':7502'"),
        ("127.0.0.1:", "to: expected HOST, HOST:PORT or [IPV6]:PORT, such as 127.0.0.1:7502, got '127.0.0.1:'"),
        ("[::1", "to: expected HOST, HOST:PORT or [IPV6]:PORT, such as 127.0.0.1:7502, got '[::1'"),
        ("[::1]7", "to: expected HOST, HOST:PORT or [IPV6]:PORT, such as 127.0.0.1:7502, got '[::1]7'"),
        ("a:b:c", "to: expected HOST, HOST:PORT or [IPV6]:PORT, such as 127.0.0.1:7502, got 'a:b:c'"),
        ("127.0.0.1:0", "to: expected a port from 1 to 65535, got '127.0.0.1:0'"),
        ("127.0.0.1:65536", "to: expected a port from 1 to 65535, got '127.0.0.1:65536'"),
        ("127.0.0.1:x", "to: expected a port from 1 to 65535, got '127.0.0.1:x'"),
        ("a\0b", "to: expected a host that is known, got 'a\\x00b' ("),
        (f"a.{'x' * 64}", "to: expected a host that is known, got 'a.xxxxxx"),  # a label has at most 63 characters
        ("255.255.255.255", "to: expected an address that can be reached, got '255.255.255.255' ("),
    ],
)
def test_bad_addresses(to: str, message: str) -> None:
    with pytest.raises((ValueError, OSError)) as caught:
        Sender(toy.lidar(), to)
    assert str(caught.value).startswith(message)


def test_bad_arguments() -> None:
    lidar = toy.lidar()
    with pytest.raises(TypeError, match="to: expected an address such as"):
        Sender(lidar, 7502)  # type: ignore[arg-type]
    with pytest.raises(ls.errors.FileFormatError, match="model: expected one with a packet format"):
        Sender(ls.Lidar.preset("sick-lms111"))
    with pytest.raises(ValueError, match="port: expected at most"):
        Sender({"a": lidar, "b": lidar}, "127.0.0.1:65534")
    with Sender(lidar) as sender:
        with pytest.raises(ValueError, match="repeat: expected an integer >= 1"):
            sender.send([], repeat=0)
        with pytest.raises(TypeError, match="scans: expected a callable"):
            sender.send([], repeat=2, period=1.0)
        with pytest.raises(ValueError, match="period: "):
            sender.send(list, repeat=2)
        with pytest.raises(TypeError, match="scans: expected scans, or mappings"):
            sender.send([1])  # type: ignore[list-item]
        with pytest.raises(ValueError, match="sensor: expected no name, as the only one has none, got 'top'"):
            sender.send([{"top": lidar.scan(room())}])
        with pytest.raises(TypeError, match="scans: expected an iterable of scans, or a callable, got Scan"):
            sender.send(lidar.scan(room()))  # type: ignore[arg-type]
        assert sender.send([]).packets == 0
    with Sender({"top": lidar}) as sender, pytest.raises(ValueError, match="sensor: expected one of top, got 'left'"):
        sender.send([{"left": lidar.scan(room())}])


CONFIG = """\
frames: 3
sensor: {pattern: {type: spinning, elevations_deg: [0], columns: 25, rate_hz: 100}}
scene: [{shape: sphere, center_m: [0, 0.5, 0], radius_m: 4}]
"""


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setitem(_format._formats, "", toy.TOY)  # the sensor of the configuration has no name
    monkeypatch.setattr(toy, "MODEL", "")
    (tmp_path / "run.yaml").write_text(CONFIG, encoding="utf-8")
    return tmp_path / "run.yaml"


def test_the_command_line_sends_and_tells(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Receiver() as receiver, pytest.raises(SystemExit) as left:
        main(["stream", str(config), "--to", f"127.0.0.1:{receiver.port}", "--fast", "--metadata", f"{config}.json"])
    assert left.value.code == 0
    assert len(receiver.payloads) == 8
    written, told = capsys.readouterr().out.splitlines()
    assert written == f"{config}.json"
    assert told.startswith(f"8 packets (0.000428 MB) to 127.0.0.1:{receiver.port}, 1 port {receiver.port} in 0.")
    assert told.endswith(" packets/s, 0 dropped")


def test_the_command_line_tells_that_the_machine_is_slower(capsys: pytest.CaptureFixture[str]) -> None:
    print_sent("::1", packets.Sent(10, 1000, 2, lag=0.3, seconds=2.0, span=1.5, ports={7502}), 0.1)
    assert capsys.readouterr().out.splitlines() == [
        "10 packets (0.001 MB) to ::1, 1 port 7502 in 2.00 s: 5 packets/s, 2 dropped, largest lag 300 ms",
        "the sensor is faster than this machine scans: 1.50 s of it took 2.00 s; packets were late, none was left out",
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--to", "127.0.0.1:0"], "to: expected a port from 1 to 65535, got '127.0.0.1:0'"),
        (["--variant", "triple"], "variant: expected one of single, dual for , got 'triple'"),
        (["--metadata", "no/such/folder.json"], "no/such/folder.json: the folder no/such does not exist"),
        (["--frames", "0"], "--set frames=0: expected a value >= 1, got 0"),
    ],
)
def test_mistakes_get_one_line(
    config: Path, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as left:
        main(["stream", str(config), *arguments])
    assert left.value.code == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


RIG = """\
frames: 2
rig:
  roof: {sensor: {preset: velodyne-vlp16}}
  front: {sensor: {preset: velodyne-vlp16}, offset_s: 0.03}
scene: [{shape: sphere, center_m: [0, 0.5, 0], radius_m: 4}]
"""


def test_the_packets_of_a_rig_with_offsets_go_on_where_repetitions_meet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rig.yaml").write_text(RIG, encoding="utf-8")
    sent: dict[int, list[int]] = {}

    def collect(_: Sender, packet: Packet) -> None:
        sent.setdefault(packet.port, []).append(packet.time)
        if packet.time / 1e9 > START + 0.5:  # in the third repetition
            raise KeyboardInterrupt

    monkeypatch.setattr(Sender, "_send", collect)
    with pytest.raises(SystemExit):
        main(["stream", str(tmp_path / "rig.yaml"), "--to", "127.0.0.1:9", "--repeat", "--fast"])
    of_data = [times for times in sent.values() if len(times) > 100]  # those of positions are few
    assert len(of_data) == 2
    for times in of_data:
        steps = np.diff(times) / 1e3
        # A packet has 24 cycles of 55.296 µs; around a seam, two cycles are less than two periods apart.
        assert np.abs(steps - 24 * 55.296).max() < 55.296 + 0.004
        assert times[-1] / 1e9 > START + 0.49


def test_interrupting_tells_what_was_sent(
    config: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    send = Sender._send

    def send_and_interrupt(sender: Sender, packet: Packet) -> None:
        send(sender, packet)
        if sender.sent.packets == 20:  # in the third repetition
            raise KeyboardInterrupt

    monkeypatch.setattr(Sender, "_send", send_and_interrupt)
    with pytest.raises(SystemExit) as left:
        main(["stream", str(config), "--to", "127.0.0.1:9", "--repeat"])
    assert left.value.code == 130
    assert capsys.readouterr().out.startswith("20 packets ")
