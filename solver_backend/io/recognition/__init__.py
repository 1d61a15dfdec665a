"""What files leave unsaid: joint sets, frame numbers, camera names, which way is up."""
