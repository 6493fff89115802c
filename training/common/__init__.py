"""What several training commands share: their options, run folders, and where results come from."""
