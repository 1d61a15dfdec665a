"""Review takes: find frame ranges to check, colour by confidence, and pin poses."""
