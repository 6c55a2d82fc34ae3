"""What is known of one depth sensor: error scale per measurement, weight, faults."""
