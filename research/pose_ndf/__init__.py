"""What papers do with Pose-NDF and the product does not."""
