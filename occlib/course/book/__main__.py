"""``python -m occlib.course.book``: make the book."""

from occlib.course.book import main

if __name__ == "__main__":
    main()
