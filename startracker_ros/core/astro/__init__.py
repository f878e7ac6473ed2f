"""Time, orbits, planets, aberration: astronomy that flight code and simulator share."""
