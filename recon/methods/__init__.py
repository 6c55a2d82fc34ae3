"""One folder per `--method`. Start at uncle/pipeline.py. registry.py lists them."""
