"""Our own two files: captures and motions."""
