"""What a client has said: poses give way to newer ones, all else stays, in its order."""

from __future__ import annotations

import asyncio

from palpate.app.view.inbox import MOST, Inbox


def pose(number):
    return {"type": "pose", "sequence": number}


def emptied(*messages):
    async def run():
        inbox = Inbox()
        for message in messages:
            await inbox.put(message)
        inbox.end()
        found = []
        while (message := await inbox.next()) is not None:
            found.append(message)
        return found

    return asyncio.run(run())


def test_of_poses_that_wait_the_newest_is_left():
    assert emptied(pose(1), pose(2), pose(3)) == [pose(3)]


def test_nothing_overtakes_what_is_no_pose():
    release, ack = {"type": "release"}, {"type": "ack", "sequence": 1}
    said = [pose(1), pose(2), release, pose(3), ack, pose(4), pose(5)]
    assert emptied(*said) == [pose(2), release, pose(3), ack, pose(5)]


def test_who_says_too_much_waits():
    async def run():
        inbox, release = Inbox(), {"type": "release"}
        for _ in range(MOST):
            await inbox.put(release)
        late = asyncio.create_task(inbox.put(pose(1)))
        await asyncio.sleep(0)
        assert not late.done()
        for _ in range(MOST):
            assert await inbox.next() == release
        await late
        assert await inbox.next() == pose(1)

    asyncio.run(run())
