"""What a movement shows of its frame rate: how people walk, how they fall, and how they keep their balance."""
