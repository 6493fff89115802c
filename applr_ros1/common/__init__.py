"""What several packages share and what knows none of them."""
