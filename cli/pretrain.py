"""`uncle pretrain`: train what some methods bring with them."""

from __future__ import annotations

import click

from .main import LazyGroup

# training -> one-line help; its command is in pretrain_NAME.py
PRETRAIN: dict[str, str] = {
    "decoders": "Train the occupancy decoders of `uncle-paper` and `nice-slam` on synthetic rooms.",
    "confidence": "Train the confidence network of `nice-slam-pre` for one sensor from true depth.",
    "senfunet": "Train the networks of `senfunet` for two sensors from true depth and a true mesh.",
}


@click.group("pretrain", cls=LazyGroup, lazy=PRETRAIN, prefix="pretrain_")
def command() -> None:
    """Train what some methods bring with them: networks that are not learned from the recording itself.

    The package ships such networks, trained with the commands below; docs/pretraining.md has recipes and figures.
    """
