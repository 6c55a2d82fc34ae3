"""The representation of NICE-SLAM and UncLe-SLAM: feature grids, frozen decoders of occupancy, their rendering."""
