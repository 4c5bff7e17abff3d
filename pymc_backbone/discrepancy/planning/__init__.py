"""Which test would tell sets apart that these records do not."""
