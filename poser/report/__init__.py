"""A comparison as people read it: tables, pictures, one page, skeletons that play."""
