"""The baseline SenFuNet: two sensors fused by a learned weight of each sample; docs/baselines.md, `senfunet`."""
