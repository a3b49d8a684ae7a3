"""The page of one calibration: what an owner of an arm reads first, drawings inside, nothing fetched."""
