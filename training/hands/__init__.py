"""The prior of hands, learned from recordings and poses that anybody may use."""
