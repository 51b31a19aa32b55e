"""What ranges rest on, measured by the user: the camera, by a printed board, and one length of the hand."""
