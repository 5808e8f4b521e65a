"""What a client has said: poses give way to newer ones, all else stays, in its order."""

from __future__ import annotations

import asyncio

from palpate.app.view.server.queue import MAX_MESSAGES, MessageQueue


def pose(number, index=0):
    return {"type": "pose", "sequence": number, "index": index}


def emptied(*messages):
    async def run():
        queue = MessageQueue()
        for message in messages:
            await queue.put(message)
        queue.close()
        found = []
        while (message := await queue.get()) is not None:
            found.append(message)
        return found

    return asyncio.run(run())


def test_only_the_newest_of_queued_poses_is_kept():
    assert emptied(pose(1), pose(2), pose(3)) == [pose(3)]


def test_alternating_poses_of_two_tools_are_kept_for_each():
    said = [pose(1), pose(1, 1), pose(2), pose(2, 1), pose(3, 1), {"type": "release"}, pose(4, 1)]
    assert emptied(*said) == [pose(2), pose(3, 1), {"type": "release"}, pose(4, 1)]


def test_poses_do_not_overtake_other_messages():
    release, ack = {"type": "release"}, {"type": "ack", "sequence": 1}
    said = [pose(1), pose(2), release, pose(3), ack, pose(4), pose(5)]
    assert emptied(*said) == [pose(2), release, pose(3), ack, pose(5)]


def test_a_sender_waits_while_the_queue_is_full():
    async def run():
        queue, release = MessageQueue(), {"type": "release"}
        for _ in range(MAX_MESSAGES):
            await queue.put(release)
        late = asyncio.create_task(queue.put(pose(1)))
        await asyncio.sleep(0)
        assert not late.done()
        for _ in range(MAX_MESSAGES):
            assert await queue.get() == release
        await late
        assert await queue.get() == pose(1)

    asyncio.run(run())
