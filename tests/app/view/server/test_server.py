"""The server with real clients: who is let in, what flows, who drives."""

from __future__ import annotations

import asyncio
import http.client
import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from view_scenes import BALL, MIDDLE
from websockets.exceptions import ConnectionClosed, InvalidStatus

from palpate.app.view.server.address import LOOPBACK, allowed_hosts, is_loopback, open_listener
from palpate.core.faults import InputError

ABOVE = MIDDLE + np.array([0, 0, BALL + 0.002])
PRESSED = MIDDLE + np.array([0, 0, BALL - 0.003])


def force(client):
    return client.states[-1][1][4] if client.states else 0.0


def get(site, path, **headers):
    """Return status, headers and body of a GET."""
    line = http.client.HTTPConnection(LOOPBACK, site.port, timeout=300)
    line.putrequest("GET", path, skip_host="Host" in headers)
    for name, value in headers.items():
        line.putheader(name, value)
    line.endheaders()
    answer = line.getresponse()
    return answer.status, answer.headers, answer.read()


# who is let in


def test_hello_describes_the_body(site, session):
    async def visit():
        async with site.client() as client:
            return client.messages[0], client.geometry, client.fixed

    hello, (points, triangles), fixed = asyncio.run(visit())
    assert hello["type"] == "hello"
    assert [scalar["signed"] for scalar in hello["scalars"]] == [False, False, True]
    np.testing.assert_array_equal(fixed, points[:, 2] < 1e-6)  # the block stands on its support
    assert (hello["driver"], hello["viewers"], hello["mode"], hello["title"]) == (True, 1, "live", "Block")
    assert hello["tools"] == ["sphere", "capsule", "grasp"]
    assert [scalar["name"] for scalar in hello["scalars"]] == ["displacement", "stress", "pressure"]
    np.testing.assert_array_equal(points, session.surface.rest)
    np.testing.assert_array_equal(triangles, session.surface.triangles)
    assert (hello["vertices"], hello["triangles"]) == (len(points), len(triangles))


def test_a_wrong_token_is_rejected(site):
    async def visit():
        async with site.client(token="guess", greet=False) as client:
            with pytest.raises(ConnectionClosed) as closed:
                await client.hear()
            return closed.value.rcvd.code

    assert asyncio.run(visit()) == 4401
    assert not site.server.viewers


def test_a_client_without_hello_is_rejected(site, monkeypatch):
    monkeypatch.setattr("palpate.app.view.server.server.HELLO_TIMEOUT", 0.1)

    async def visit():
        from websockets.asyncio.client import connect

        async with connect(f"ws://{LOOPBACK}:{site.port}/session", subprotocols=["palpate.v2"]) as socket:
            with pytest.raises(ConnectionClosed) as closed:
                await socket.recv()
            return closed.value.rcvd.code

    assert asyncio.run(visit()) == 4401


@pytest.mark.parametrize(
    ("options", "status"),
    [
        ({"origin": "http://example.org"}, 403),
        ({"origin": "null"}, 403),
        ({"additional_headers": {"Host": "example.org"}}, 403),
        ({"subprotocols": None}, 400),
        ({"subprotocols": ["palpate.v9"]}, 400),
        ({"subprotocols": ["palpate.v1"]}, 400),
    ],
)
def test_pages_of_other_origins_are_rejected(site, options, status):
    async def visit():
        async with site.client(greet=False, **options):
            pass

    with pytest.raises(InvalidStatus) as refused:
        asyncio.run(visit())
    assert refused.value.response.status_code == status


def test_the_page_of_the_server_is_accepted(site):
    async def visit():
        async with site.client(origin=f"http://localhost:{site.port}") as client:
            return client.messages[0]["type"]

    assert asyncio.run(visit()) == "hello"


def test_only_files_of_the_page_are_served(session, site_of, tmp_path):
    (tmp_path / "page" / "assets").mkdir(parents=True)
    (tmp_path / "secret.txt").write_text("secret")
    (tmp_path / "page" / "index.html").write_text("<p>hello</p>")
    (tmp_path / "page" / "assets" / "page.js").write_text("1")
    (tmp_path / "page" / "notes.md").write_text("not for all")
    site = site_of(session, tmp_path / "page")
    (tmp_path / "page" / "late.js").write_text("2")
    status, headers, body = get(site, "/")
    assert (status, body, headers["Content-Type"]) == (200, b"<p>hello</p>", "text/html; charset=utf-8")
    assert headers["Cache-Control"] == "no-store"
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    assert f"connect-src 'self' ws://{LOOPBACK}:{site.port}" in headers["Content-Security-Policy"]
    status, headers, _ = get(site, "/assets/page.js?v=1")
    assert (status, headers["Content-Type"]) == (200, "text/javascript; charset=utf-8")
    for path in ("/late.js", "/notes.md", "/../secret.txt", "/assets/../../secret.txt", "/assets", "//etc/passwd"):
        assert get(site, path)[0] == 404, path
    assert get(site, "/", Host="example.org")[0] == 403
    assert get(site, "/", Host=f"localhost:{site.port}")[0] == 200


def test_without_the_page_the_server_responds_with_a_message(session, site_of, tmp_path):
    status, _, body = get(site_of(session, tmp_path), "/")
    assert status == 503
    assert b"The page was not built" in body


def test_a_busy_port_gives_the_next():
    first = open_listener(LOOPBACK, 18900)
    second = open_listener(LOOPBACK, first.getsockname()[1])
    assert second.getsockname()[1] > first.getsockname()[1]
    for each in (first, second):
        each.close()


def test_allowed_hosts_and_loopback_addresses():
    assert allowed_hosts(LOOPBACK, 80) == ["127.0.0.1:80", "localhost:80", "[::1]:80"]
    assert allowed_hosts("192.0.2.1", 80) == ["192.0.2.1:80"]
    assert is_loopback(LOOPBACK)
    assert not is_loopback("192.0.2.1")
    for host, said in (("0.0.0.0", "a single address"), ("192.0.2.1", "an address of this"), ("here", "an IP address")):
        with pytest.raises(InputError, match=said):
            open_listener(host, 18950)


# what flows


def test_at_most_two_frames_are_in_flight_and_then_the_newest_comes(site, session, ball):
    async def visit():
        async with site.client(draws=False) as client:
            await client.say(**ball)
            await client.hear_until(lambda c: len(c.states) == 2)
            await client.say(type="pose", position=PRESSED.tolist())
            for stamp in range(4):  # all this time frames are made and dropped
                await asyncio.sleep(0.2)
                await client.say(type="latency", stamp=stamp)
                await client.told("latency", stamp=stamp)
            assert len(client.states) == 2
            now = session.snapshot()
            await client.say(type="ack", sequence=client.states[0][0])
            await client.hear_until(lambda c: len(c.states) == 3)
            sequences = [state[0] for state in client.states]
            assert sequences == [1, 2, 3]
            assert client.states[-1][1][0] >= now.time - 0.05
            assert client.states[1][1][0] < now.time - 0.2
            await client.say(type="ack", sequence=99)
            assert "must be at most" in (await client.told("error"))["reason"]

    asyncio.run(visit())


def test_a_press_is_seen_and_a_release_ends_it(site, session, ball):
    async def visit():
        async with site.client() as client:
            await client.say(**ball)
            await client.told("status", state="running")
            await client.say(type="pose", position=PRESSED.tolist(), sequence=7)
            await client.hear_until(lambda c: force(c) > 0.05)
            await client.hear_until(lambda c: c.states[-1][1][24] == 7 and c.states[-1][1][10] < PRESSED[2] + 1e-6)
            _, head, points, values = client.states[-1]
            middle = int(np.argmin(np.linalg.norm(client.geometry[0] - MIDDLE, axis=1)))
            assert points[middle, 2] < MIDDLE[2] - 0.001
            np.testing.assert_allclose(values, np.linalg.norm(points - client.geometry[0], axis=1), atol=1e-6)
            assert head[23] == pytest.approx(np.percentile(values, 99), rel=1e-3)
            assert (head[20], head[21]) == (1, 1)  # running, sphere
            await client.say(type="show", scalar="stress")
            await client.hear_until(lambda c: c.states[-1][1][23] > 10.0)  # [Pa]
            await client.say(type="show", scalar="none")
            await client.hear_until(lambda c: len(c.states[-1][3]) == 0)
            await client.say(type="release")
            await client.hear_until(lambda c: not c.states[-1][1][2:5].any())
            assert client.states[-1][1][21] == 0
            await client.say(type="control", action="reset")
            await client.hear_until(lambda c: np.array_equal(c.states[-1][2], c.geometry[0]))

    asyncio.run(visit())


def test_statistics_are_sent_regularly(site):
    async def visit():
        async with site.client() as client:
            first = await client.told("statistics")
            await client.hear_until(lambda c: [m["type"] for m in c.messages].count("statistics") > 2)
            return first, client.messages[-1]

    first, last = asyncio.run(visit())
    assert last["periods"] > first["periods"]
    assert 0 < last["median_ms"] < 1
    assert set(last) == {"type", "median_ms", "p99_ms", "misses", "periods", "pace", "force_bound"}


def test_a_client_gets_forces_at_its_rate(site, ball):
    async def visit():
        async with site.client() as client:
            await client.say(**ball)
            await client.say(type="pose", position=PRESSED.tolist(), sequence=3)
            await client.say(type="force", rate=200)
            await client.hear_until(lambda c: c.forces and c.forces[-1][4] > 0.05 and c.forces[-1][16] > 1.0)
            await client.say(type="force", rate=0)
            return client.forces[-1]

    numbers = asyncio.run(visit())
    assert numbers[22] == 3  # the pose that it knew
    assert numbers[16] > 1.0  # dF_z/dz [N/m]


def test_force_frames_are_of_one_period_each_and_go_on_in_a_pause(site, ball):
    async def visit():
        async with site.client() as client:
            await client.say(**ball)
            await client.say(type="force", rate=1000)
            await client.hear_until(lambda c: len(c.forces) > 100)
            running = len(client.forces)
            await client.say(type="control", action="pause")
            await client.hear_until(lambda c: len(c.forces) > running + 2 and c.forces[-1][20] == c.forces[-3][20])
            return np.array([force[20] for force in client.forces[:running]]), client.forces[-1][21]

    steps, state = asyncio.run(visit())
    assert (np.diff(steps) >= 0).all()
    assert np.mean(np.diff(steps) > 0) > 0.9  # the same one comes again only where the engine stood still for 0.1 s
    assert state == 2  # paused


def test_a_flood_of_poses_is_merged_and_the_last_one_counts(site, session, ball, monkeypatch):
    processed, handle = [], session.handle

    def counted(message):
        if message["type"] == "pose":
            processed.append(message["sequence"])
        handle(message)

    monkeypatch.setattr(session, "handle", counted)
    count = 500

    async def visit():
        async with site.client(draws=False) as client:
            await client.say(**ball)
            await client.say(type="force", rate=1000)
            for k in range(1, count + 1):
                await client.say(type="pose", position=(ABOVE - np.array([0, 0, 1e-6 * k])).tolist(), sequence=k)
            await client.hear_until(lambda c: c.forces and c.forces[-1][22] == count)
            return [int(force[22]) for force in client.forces]

    answered = asyncio.run(visit())
    assert processed == sorted(processed)
    assert processed[-1] == count
    assert len(processed) < count  # the others gave way
    assert answered == sorted(answered)
    assert set(answered) <= {0, *processed}


def test_the_example_of_a_haptic_client_presses_by_version_2(site, capsys):
    path = Path(__file__).parents[4] / "examples" / "haptic_client.py"
    example = runpy.run_path(str(path))
    asyncio.run(example["main"](site.address, 1.5))
    told = capsys.readouterr().out
    assert float(re.search(r"largest ([\d.e-]+) N", told)[1]) > 0.02
    assert float(re.search(r"median ([\d.]+) ms", told)[1]) > 0.0


# who drives, and what goes wrong


def test_a_second_viewer_watches_and_cannot_move_the_tool(site, ball, monkeypatch):
    async def visit():
        async with site.client() as first, site.client() as second:
            assert second.messages[0]["driver"] is False
            assert second.messages[0]["viewers"] == 2
            for message in (ball, {"type": "release"}, {"type": "control", "action": "reset"}):
                second.messages.clear()
                await second.say(**message)
                assert "sender must be the driver" in (await second.told("error"))["reason"]
            second.messages.clear()
            await second.say(type="drive")
            assert "10 s" in (await second.told("error"))["reason"]
            await first.say(**ball)
            await first.say(type="pose", position=PRESSED.tolist())
            await second.hear_until(lambda c: force(c) > 0.05)  # it sees what the first does
            monkeypatch.setattr("palpate.app.view.server.server.DRIVER_TIMEOUT", 0.0)
            second.messages.clear()
            await second.say(type="drive")
            await second.told("status", driver=True)
            await first.told("status", driver=False)
            await second.hear_until(lambda c: force(c) == 0.0)  # the tool was taken from the first

    asyncio.run(visit())


def test_the_tool_is_removed_when_its_driver_disconnects(site, session, ball, until):
    async def visit():
        async with site.client() as watching:
            watching_is_driver = watching.messages[0]["driver"]
            assert watching_is_driver
            await watching.say(**ball)
            await watching.say(type="pose", position=PRESSED.tolist())
            await watching.hear_until(lambda c: force(c) > 0.05)

    asyncio.run(visit())
    until(lambda: session.pause_reason == "viewers left")
    assert session.status()["state"] == "paused"
    assert session.snapshot().tools[0].kind == "none"

    async def again():
        async with site.client() as client:
            assert client.messages[0]["driver"] is True
            await client.told("status", state="running")
            await client.hear_until(lambda c: len(c.states) > 3)

    asyncio.run(again())


def test_the_session_pauses_without_viewers(site, session, until):
    until(lambda: session.pause_reason == "no viewers")
    assert session.status()["state"] == "paused"


def test_malformed_messages_are_answered_and_ten_in_a_row_end_the_connection(site, until):
    async def visit():
        async with site.client() as client:
            for _ in range(9):
                await client.socket.send("{not json")
            await client.say(type="latency", stamp="still here")
            await client.told("latency")
            assert [m["type"] for m in client.messages].count("error") == 9
            for _ in range(10):
                await client.socket.send(json.dumps({"type": "fly"}))
            with pytest.raises(ConnectionClosed) as closed:
                await client.hear_until(lambda c: False)
            return closed.value.rcvd.code

    assert asyncio.run(visit()) == 4400
    until(lambda: not site.server.viewers)


def test_oversized_messages_end_the_connection_and_the_server_continues(site):
    async def visit():
        async with site.client() as client:
            await client.socket.send(" " * (64 * 1024 + 1))
            with pytest.raises(ConnectionClosed) as closed:
                await client.hear_until(lambda c: False)
            code = closed.value.rcvd.code
        async with site.client() as client:
            assert client.messages[0]["type"] == "hello"
        return code

    assert asyncio.run(visit()) == 1009


def test_invalid_requests_are_refused_and_the_session_continues(site, ball):
    async def visit():
        async with site.client() as client:
            await client.say(**{**ball, "position": [0.024, 0.024, 0.01]})
            assert "outside the body" in (await client.told("error"))["reason"]
            for message, said in (
                ({"type": "record", "action": "stop"}, "got 'stop'"),
                ({"type": "replay", "action": "play"}, "live sessions"),
                ({"type": "material", "name": "colour", "value": 1}, "name must be 'shear modulus'"),
                ({"type": "hello", "protocol": 2, "token": "x"}, "after the first message"),
            ):
                client.messages.clear()
                await client.say(**message)
                assert said in (await client.told("error"))["reason"]
            await client.hear_until(lambda c: len(c.states) > 2)

    asyncio.run(visit())


# who harms


async def closing(client):
    """Hear until the connection is closed, and return why."""
    with pytest.raises(ConnectionClosed) as closed:
        await client.hear_until(lambda c: False)
    return closed.value.rcvd.code, closed.value.rcvd.reason


@pytest.mark.parametrize(
    ("hello", "code"),
    [
        ('{"type": "hello", "protocol": 2, "token": "\\ud800"}', 4401),
        (json.dumps({"type": "\U0001f9e0" * 60}), 4401),
        ('{"type": "hello", "protocol": 2, "protocol": 2, "token": "x"}', 4401),
        ("[" * 30_000, 4401),
        ("", 4401),
        (b"", 4401),
        (b"\x00" * 99, 4401),
        (json.dumps({"type": "hello", "protocol": 1, "token": "a-token-of-tests"}), 4400),
        (json.dumps({"type": "drive"}), 4401),
        (" " * (64 * 1024 + 1), 1009),
    ],
)
def test_an_invalid_hello_is_rejected_with_a_reason(site, hello, code, caplog):
    from websockets.asyncio.client import connect

    async def visit():
        async with connect(f"ws://{LOOPBACK}:{site.port}/session", subprotocols=["palpate.v2"]) as socket:
            await socket.send(hello)
            with pytest.raises(ConnectionClosed) as closed:
                await socket.recv()
            return closed.value.rcvd

    told = asyncio.run(visit())
    assert told.code == code
    assert len(told.reason.encode()) <= 123
    assert told.reason
    assert not caplog.records


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ('{"type": "latency", "stamp": 1e999}', "not finite"),
        (json.dumps({"type": "\U0001f9e0" * 60}), "must be one of hello"),
        ('{"type": "latency", "stamp": ' + "[" * 50 + "]" * 50 + "}", "nested"),
        ('{"type": "ack", "sequence": 1, "sequence": 1}', "twice"),
        ("", "not valid JSON"),
        (b"", "binary"),
        (["{", '"type"', ": 1}"], "must be one of hello"),  # in fragments
    ],
)
def test_unknown_messages_are_answered_with_an_error(site, message, said, caplog):
    async def visit():
        async with site.client() as client:
            await client.socket.send(message)
            reason = (await client.told("error"))["reason"]
            await client.told("statistics")
            return reason

    assert said in asyncio.run(visit())
    assert not caplog.records


def test_invalid_utf8_ends_the_connection(site, caplog):
    async def visit():
        async with site.client() as client:
            await client.socket.send(b"\xff\xfe", text=True)
            return (await closing(client))[0]

    assert asyncio.run(visit()) == 1007
    assert not caplog.records


def test_a_rate_is_changed_at_once(site):
    async def visit():
        async with site.client() as client:
            await client.say(type="force", rate=1)
            await client.hear_until(lambda c: len(c.forces) == 1)
            await client.say(type="force", rate=500)
            await client.hear_until(lambda c: len(c.forces) > 20)
            await client.say(type="force", rate=0)
            await client.say(type="latency")
            await client.told("latency")
            count = len(client.forces)
            client.messages.clear()
            await client.told("statistics")
            await client.hear()
            return count, len(client.forces)

    before, after = asyncio.run(visit())
    assert after == before


def test_a_client_that_does_not_read_is_disconnected_and_delays_no_other(site, monkeypatch, until):
    monkeypatch.setattr("palpate.app.view.server.viewer.SEND_TIMEOUT", 0.3)
    monkeypatch.setattr("palpate.app.view.server.connection.CLOSE_TIMEOUT", 0.1)

    async def visit():
        async with site.client(draws=False) as stuck, site.client() as other:
            await other.told("status", viewers=2)
            transport = stuck.socket.transport
            transport.pause_reading()
            viewer = next(v for v in site.server.viewers if v.socket.remote_address == stuck.socket.local_address)
            site.loop.call_soon_threadsafe(viewer.socket.transport.write, bytes(2**25))  # more than systems hold
            site.loop.call_soon_threadsafe(setattr, site.server, "_max_unsent", 2**30)
            heard = 0
            while len(site.server.viewers) > 1:
                other.messages.clear()
                await other.told("statistics")
                heard += 1
                assert heard < 40
            transport.abort()
            return heard

    # 33 MB may wait for 33 s: as long as they are read at 1 MB/s; cut short here
    monkeypatch.setattr("palpate.app.view.server.viewer.MIN_READ_RATE", 1e9)
    assert asyncio.run(visit()) > 0


def test_the_number_of_unsent_bytes_is_bounded(site, until):
    async def visit():
        async with site.client(draws=False) as stuck:
            stuck.socket.transport.pause_reading()
            viewer = site.server.viewers[0]
            site.loop.call_soon_threadsafe(viewer.socket.transport.write, bytes(2**25))
            await asyncio.to_thread(until, lambda: not site.server.viewers)
            stuck.socket.transport.abort()

    asyncio.run(visit())


def test_a_client_that_neither_acknowledges_nor_sends_is_disconnected(site, monkeypatch):
    monkeypatch.setattr("palpate.app.view.server.viewer.RESPONSE_TIMEOUT", 0.5)

    async def visit():
        async with site.client(draws=False) as blind, site.client(draws=False) as feels, site.client() as draws:
            await feels.say(type="force", rate=10)
            open_listener = [asyncio.ensure_future(each.hear_until(lambda c: False)) for each in (feels, draws)]
            told = await closing(blind)
            await asyncio.sleep(1.0)
            left = [each.done() for each in open_listener]
            for each in open_listener:
                each.cancel()
            await asyncio.wait(open_listener)
            return told, left

    told, left = asyncio.run(visit())
    assert told == (4408, "frames are not acknowledged")
    assert left == [False, False]


def test_an_internal_error_ends_one_connection_and_is_logged_once(site, session, monkeypatch, caplog):
    async def visit():
        async with site.client() as first:
            monkeypatch.setattr(session, "hello", lambda: {}["gone"])
            for _ in range(2):
                async with site.client(greet=False) as second:
                    assert (await closing(second))[0] == 1011
            first.messages.clear()
            await first.told("statistics")
            monkeypatch.setattr(session, "status", lambda: {}["lost"])
            await asyncio.sleep(0.3)
            monkeypatch.undo()
            first.messages.clear()
            await first.told("statistics")
            monkeypatch.setattr(session, "handle", lambda message: 1 / 0)
            await first.say(type="release")
            assert (await closing(first))[0] == 1011
        monkeypatch.undo()
        async with site.client() as third:
            return third.messages[0]["viewers"]

    assert asyncio.run(visit()) == 1
    said = [record.getMessage() for record in caplog.records]
    assert said == [
        "a viewer's connection failed: KeyError: 'gone'; the server continues",
        "the session failed: KeyError: 'lost'; the server continues",
        "a viewer's connection failed: ZeroDivisionError: division by zero; the server continues",
    ]
    assert all(record.exc_info is None for record in caplog.records)


def test_a_diverged_state_is_shown_and_can_be_reset(site, session, until):
    async def visit():
        async with site.client() as client:
            await client.told("statistics")
            session.engine.pause()
            session.engine._runner.state = 3
        until(lambda: not site.server.viewers)
        async with site.client() as client:
            await client.told("status", state="diverged")
            await client.say(type="control", action="reset")
            await client.told("status", state="running")

    asyncio.run(visit())


def test_the_number_of_connections_is_limited(site, monkeypatch, until):
    import socket

    monkeypatch.setattr("palpate.app.view.server.connection.MAX_CONNECTIONS", 8)
    opened = [socket.create_connection((LOOPBACK, site.port), 5) for _ in range(20)]
    until(lambda: len(site.server._connections) == 8)
    for each in opened:
        each.close()
    until(lambda: not site.server._connections)
    assert get(site, "/")[0] in (200, 503)


def test_connections_that_send_nothing_keep_no_client_out(site, monkeypatch, until):
    import socket

    monkeypatch.setattr("palpate.app.view.server.connection.MAX_CONNECTIONS", 8)

    async def visit():
        async with site.client() as viewer:
            first = [socket.create_connection((LOOPBACK, site.port), 5) for _ in range(20)]
            until(lambda: len(site.server._connections) == 8)
            await asyncio.sleep(0.3)  # the time that a client has for its hello
            async with site.client() as client:  # while all of them are open
                await client.say(type="latency", stamp=1.0)
                await client.told("latency")
            viewer.messages.clear()
            await viewer.say(type="latency", stamp=2.0)
            await viewer.told("latency")  # the first viewer is still there
            for each in first:
                each.close()

    asyncio.run(visit())


def test_the_server_closes_while_a_client_does_not_read(session, site_of):
    own = site_of(session)

    async def visit():
        async with own.client(draws=False) as stuck:
            stuck.socket.transport.pause_reading()
            viewer = own.server.viewers[0]
            own.loop.call_soon_threadsafe(setattr, own.server, "_max_unsent", 2**30)
            own.loop.call_soon_threadsafe(viewer.socket.transport.write, bytes(2**25))
            await asyncio.sleep(0.1)
            await asyncio.to_thread(own.close)
            ended = not own.thread.is_alive()  # while the client is still there
            stuck.socket.transport.abort()
            return ended

    assert asyncio.run(visit())
