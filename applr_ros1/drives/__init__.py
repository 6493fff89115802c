"""Web page that replays recorded drives."""
