"""Why a robot stopped, as far as it can say so itself: events, reasons, replay and guesses."""
