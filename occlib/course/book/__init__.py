"""The book: executed notebooks and the texts of docs as pages that need no network and no server."""
# fmt: off

from occlib.course.book.build import build_book, build_pages, main
from occlib.course.book.site import check_site

__all__ = ["build_book", "build_pages", "check_site", "main"]
