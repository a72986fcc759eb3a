"""Where stars are seen from the ship: catalogue, place, weather, apparent directions and their common errors."""
