"""From photos to a dataset: camera poses by a board of tags or from elsewhere, boxes, masks, and checks of them."""
