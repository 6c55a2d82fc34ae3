"""The baseline SenFuNet: two sensors fused by a learned weight of each sample (METHOD, baselines, SenFuNet)."""
