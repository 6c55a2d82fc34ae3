"""`uncle pretrain`: train what some methods bring with them."""

from __future__ import annotations

import click

from .main import LazyGroup

# training -> one-line help; its command is in pretrain_NAME.py
PRETRAIN: dict[str, str] = {
    "decoders": "Train the occupancy decoders of `uncle-paper` and `nice-slam` on made rooms.",
}


@click.group("pretrain", cls=LazyGroup, lazy=PRETRAIN, prefix="pretrain_")
def command() -> None:
    """Train what some methods bring with them: networks that are not learned from the recording itself.

    The package ships the decoders, trained with the command below; docs/pretraining.md has the recipe and its figures.
    """
