"""Results on disk: the folder of a run, its tables and fields, and the way back from them."""
