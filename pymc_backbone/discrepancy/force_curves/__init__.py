"""What the named part leaves, as a force over displacement or velocity."""
