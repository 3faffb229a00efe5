"""Dense water: the high orders' light field as moments over direction on coarse cells, found by one linear solve."""
