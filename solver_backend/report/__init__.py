"""Write self-contained HTML pages about captures, labelled takes and solves."""
