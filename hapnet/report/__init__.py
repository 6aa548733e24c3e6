"""What people look at after a run: figures, the summary as tables, and both on one page."""

from hapnet.report.figures import figure
from hapnet.report.files import png, save, save_figure
from hapnet.report.histograms import lateness_histogram, link_histogram
from hapnet.report.page import Source, page
from hapnet.report.pictures import Picture, pictures
from hapnet.report.tables import brief_text, summary_text
from hapnet.report.words import legible, verdict

__all__ = [
    "Picture",
    "Source",
    "brief_text",
    "figure",
    "lateness_histogram",
    "legible",
    "link_histogram",
    "page",
    "pictures",
    "png",
    "save",
    "save_figure",
    "summary_text",
    "verdict",
]
