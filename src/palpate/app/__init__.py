"""Command line, figures, sessions and the page.

`cli` > `export` > (`view` | `new` | `run` | `check` | `fit` | `laws` | `studies`) > `device` > `session` > `models` >
`train` > `recordings` > (`common` | `documentation`): a room imports only those to its right. `export` is above the
others because it writes the page of a view, and `models` above `train` because a campaign trains the model of a scene.

- `common`: options and their messages, the run of a command, reports, figures, pictures
- `recordings`: files of sessions, snapshots, and the tool paths in them
- `train`: campaigns: runs of workers, the model of them, its report
- `models`: what a command names, opened once: a scene or a model; the full or reduced body of a session
- `session`: the owner of an engine and of its user's tools, without a page; comparisons and replays
- `device`: haptic devices: `hand_loop.py` is what the adapter does at each message, in a process of its own
- `view`: the page: its server in a thread, the refinement by a reduced model, films
- `studies`: `palpate reproduce`: full and reduced models of the paper's examples
- `run`, `new`, `check`, `fit`, `laws`, `export`: one command each; `parser.py` imports only the standard library
"""
