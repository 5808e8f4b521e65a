"""Parser of ``palpate run``."""

from __future__ import annotations

from typing import Any

from palpate.app.common.arguments import add_command, add_output, add_parameter, existing_file, number, path
from palpate.app.common.surface_options import add_surface_options
from palpate.app.device.options import add_device
from palpate.scenes.description import Body, Tissue, Training
from palpate.scenes.names import listed_scenes
from palpate.surface.formats.names import listed_formats


def add_run(commands: Any) -> None:
    """Add the command to those of a parser."""
    run = add_command(
        commands,
        "run",
        "palpate.app.run.command:run",
        summary="run a body, once or in real time, and report its cost",
        description="Run the full body of a scene under its loads, or under a press of its tool if it has none, and "
        "with --modes also a hyper-reduced model of that run. Leave the trajectories and a report in a folder. With "
        "--realtime, step the scene's reduced model at a fixed rate while its tool presses or moves it, again and "
        "again; the model is trained at the first start. With --script, lines of JSON drive the tool as a page does. "
        "Report how well the rate was kept, and the force on the tool.",
    )
    run.assignments["given"] = "--set"
    add = run.add_argument
    text = (
        f"{listed_scenes()}, a scene file (organ.toml), or a surface file ({listed_formats()}); with --script also the "
        "file of a reduced model. A single run of the beam is the paper's"
    )
    add("source", metavar="SCENE|FILE", help=text)
    text = "settings of the scene, such as spacing=5mm"
    add("--set", nargs="+", action="extend", default=[], dest="given", metavar="NAME=X", help=text)
    add_parameter(run, Body, "spacing", " (default: that of the scene)")
    add("--load", type=number, metavar="N", help="largest force [N] on the paper's beam (default: 100)")
    add_parameter(run, Tissue, "poisson", " (default: that of the scene)")
    text = " (default: no reduced model; in real time that of the scene)"
    add_parameter(run, Training, "modes", text)
    add("--realtime", action="store_true", help="step at a fixed rate while a tool moves")
    text = "in real time: load this reduced model of palpate train, train none"
    add("--model", type=existing_file, metavar="FILE", help=text)
    add("--full", action="store_true", help="in real time: step the full body; nothing is trained")
    add(
        "--cut",
        action="store_true",
        help="in real time: step the full body, and cut it with a scalpel; nothing is trained",
    )
    text = "in real time: drive the tool by a script, lines of JSON, see docs/reference/protocol.md"
    add("--script", type=existing_file, metavar="FILE", help=text)
    text = "in real time: record the session, and write it to this file at the end"
    add("--record", type=path, metavar="FILE.h5", help=text)
    add("--seconds", type=number, metavar="S", help="in real time: length of the run [s], at most 600 (default: 10)")
    add("--rate", type=number, metavar="HZ", help="in real time: steps per second, 50 to 20000 (default: 1000)")
    add_device(run)
    add_surface_options(run)
    add_output(run, "out/run")
