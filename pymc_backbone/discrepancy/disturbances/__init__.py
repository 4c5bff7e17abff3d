"""What sensors, filters, hands and other modes add to records, asked after a first search."""
