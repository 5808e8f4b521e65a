"""What a command names, opened once, and the body that a session steps.

- A name or a file (TOML, surface, label map): `open_scene` returns a `Scene`, whose surface and material are read, and
  whose cloud, body and loads are made, at their first use. ``new``, ``check`` and ``train`` take it; `training_of`
  makes the `TrainingScene` of a campaign.
- The file of a model: `load` returns a `ReducedModel`.
- Either: `open_input` returns an `Input` for ``view``, ``run --realtime`` and ``export``. `prepare_full_body` makes its
  full body in real time, and `Input.reduced` its reduced model, trained where it is missing.
"""
