"""Why a robot stopped, as the robot alone can say: events, reasons, replay and guesses."""
