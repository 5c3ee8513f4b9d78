"""Any log as a new MCAP: whole, in part, examined, repaired."""
