"""Views that nobody photographed: an object from beside where its photos were taken, nearer, and in another light."""
