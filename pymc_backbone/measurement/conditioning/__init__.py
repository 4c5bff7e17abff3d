"""What a record takes before its cycles are looked at: release, filters, integration, noise, one question a file."""
