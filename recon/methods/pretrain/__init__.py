"""Training of what the methods bring with them, on scenes made here: no data set is needed."""
