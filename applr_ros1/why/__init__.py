"""Robot side of why a robot stopped: events, reasons, replay and guesses."""
