"""What matters in the recipe of decoders: python benchmarks/decoder_recipes.py OUT [--only NAME ...] [--device cuda]

Trains decoders with one setting changed at a time, scores each as benchmarks/decoders.py does, and prints a table. The
decoders are kept in OUT; those that are there are scored again but not trained again.
"""

import argparse
from pathlib import Path

from decoders import score
from encoder_decoders import train_with_encoder
from uncle.recon.core.device import choose_device
from uncle.recon.methods.nice.decoder_files import load_decoders, save_decoders
from uncle.recon.methods.pretrain.decoder_run import pretrain_decoders
from uncle.recon.methods.pretrain.decoder_training import DecoderTraining

RECIPES = {
    "default": {},
    "slope 1": {"slope": 1.0, "free_logit": -1.0},
    "slope 3": {"slope": 3.0, "free_logit": -0.6},
    "freer": {"free_logit": -0.6},
    "fine gain 1": {"fine_gain": 1.0},
    "fine gain 30": {"fine_gain": 30.0},
    "life 192": {"life": 192},
    "encoder": {},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="+", choices=list(RECIPES), default=list(RECIPES))
    parser.add_argument("--steps", type=int, default=800)
    parser.add_argument("--cubes", type=int, default=24)
    parser.add_argument("--rooms", type=int, default=3)
    parser.add_argument("--side", type=int, default=48)
    parser.add_argument("--rays", type=int, default=400)
    parser.add_argument("--device", choices=["auto", "cpu", "cuda"], default="auto")
    arguments = parser.parse_args()
    device = choose_device(arguments.device)
    print("| recipe | F 5 cm, % | F 2 cm, % | error, cm | bias, cm | IoU middle, % | IoU fine, % | logit near zero |")
    print("|---|---|---|---|---|---|---|---|")
    for name in arguments.only:
        file = arguments.out / f"{name.replace(' ', '-')}.pt"
        if not file.exists():
            settings = DecoderTraining(steps=arguments.steps, cubes=arguments.cubes, **RECIPES[name])
            if name == "encoder":
                save_decoders(file, train_with_encoder(settings, device))
            else:
                pretrain_decoders(file, settings, device)
        scores = score(load_decoders(file), arguments.rooms, arguments.side, arguments.rays, device)
        rooms, cubes = scores["rooms"], scores["cubes"]
        shares = [100 * value for value in (rooms["f_5cm"], rooms["f_2cm"])]
        shares += [100 * rooms["median_m"], 100 * rooms["bias_m"], 100 * cubes["middle_iou"], 100 * cubes["fine_iou"]]
        print(f"| {name} | {' | '.join(f'{value:.1f}' for value in shares)} | {cubes['fresh_logit']:.2f} |", flush=True)


if __name__ == "__main__":
    main()
