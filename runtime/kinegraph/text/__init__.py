"""Text processing: captions to word pieces and to semantic graphs."""
