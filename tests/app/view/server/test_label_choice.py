"""The choice of labels: the list that viewers get, choices that are refused, and the preparation that follows."""

from __future__ import annotations

import asyncio
import threading

import pytest
from websockets.exceptions import ConnectionClosed

from palpate.app.view.server.label_choice import LabelChoice
from palpate.app.view.server.preparation import Preparation
from palpate.core.faults import InputError
from palpate.scenes.organ import liver_surface
from palpate.surface.labels.inner import InnerLabel
from palpate.surface.labels.label_map import Segment
from palpate.surface.labels.listing import LabelRow

TUMOUR = InnerLabel(Segment(7, "tumour", 0, 7, 9), "tumour", 2.4e-5, True, "a lesion by its name", "left empty")
ROWS = [LabelRow(5, "liver", "liver", 1.2e-3, 2, True, (TUMOUR,)), LabelRow(3, "kidney", "3", 1.5e-4, 1, False)]


@pytest.fixture
def choice():
    return LabelChoice("trunk.nii.gz", ROWS)


@pytest.fixture
def preparation(tmp_path):
    made = Preparation("Liver", "liver", liver_surface(0.008), tmp_path / "durations.json")
    yield made
    made.close()


def test_a_choice_is_of_the_list_and_each_part_counts_once(choice):
    choice.choose(["3", "liver", "3"])
    assert choice.wait() == (("3", "liver"), ())
    choice.choose(["liver#1"])
    assert choice.wait().parts == ("liver#1",)


@pytest.mark.parametrize(("parts", "reason"), [(["spleen"], "of the list, got 'spleen'"), ([], "one or more")])
def test_other_choices_are_refused(choice, parts, reason):
    with pytest.raises(InputError, match=reason):
        choice.choose(parts)


def test_what_is_left_out_must_join_a_part(choice):
    choice.choose(["liver"], ["tumour"])
    assert choice.wait() == (("liver",), ("tumour",))
    with pytest.raises(InputError, match="without must be of what joins the parts, got 'tumour'"):
        choice.choose(["3"], ["tumour"])


def test_a_second_choice_waits_for_the_first(choice):
    choice.choose(["liver"])
    with pytest.raises(InputError, match="another one"):
        choice.choose(["3"])


def test_a_viewer_chooses_and_then_the_body_is_prepared_for_all(choice, preparation, site_of):
    site = site_of(choice)

    async def run():
        asks = {"preparation": True}
        async with site.client(greet=False, more=asks) as own, site.client(greet=False, more=asks) as other:
            listed = (await own.told("labels"))["labels"]
            assert listed[0] == {
                "part": "liver", "number": 5, "name": "liver", "volume": 1.2e-3, "pieces": 2, "at_edge": True,
                "inner": [{"part": "tumour", "name": "tumour", "joins": True, "why": "24 ml, a lesion by its name"}],
            }  # fmt: skip
            assert [label["part"] for label in listed] == ["liver", "3"]
            await other.told("labels")
            await own.say(type="choose", parts=["spleen"])
            assert "must be of the list" in (await own.told("error"))["reason"]
            await own.say(type="control", action="pause")
            await own.hear_until(lambda c: len([m for m in c.messages if m["type"] == "error"]) == 2)
            await own.say(type="choose", parts=["liver", "3"], without=["tumour"])
            assert await asyncio.to_thread(choice.wait) == (("liver", "3"), ("tumour",))
            site.loop.call_soon_threadsafe(site.server.refuse, "liver and 3 must touch")
            assert (await other.told("error"))["reason"] == "liver and 3 must touch"
            await other.say(type="choose", parts=["3"])
            assert await asyncio.to_thread(choice.wait) == (("3",), ())
            site.loop.call_soon_threadsafe(site.server.prepare, preparation)
            assert (await own.told("preparing"))["title"] == "Liver"
            assert (await other.told("preparing"))["space"] == ""

    asyncio.run(run())


def test_ten_invalid_choices_end_the_connection_of_their_viewer_alone(choice, preparation, site_of):
    site = site_of(choice)

    async def run():
        asks = {"preparation": True}
        async with site.client(greet=False, more=asks) as other, site.client(greet=False, more=asks) as own:
            await other.told("labels")
            for _ in range(10):
                await own.say(type="choose", parts=7)
            with pytest.raises(ConnectionClosed) as closed:
                await own.hear_until(lambda c: False)
            assert closed.value.rcvd.code == 4400
            await other.say(type="choose", parts=["3"])
            assert await asyncio.to_thread(choice.wait) == (("3",), ())

    asyncio.run(run())


def test_the_wait_ends_with_a_choice_made_in_another_thread(choice):
    threading.Timer(0.05, choice.choose, [["3"]]).start()
    assert choice.wait() == (("3",), ())
