"""What people look at after a run: figures, the summary as tables, and both on one page."""

from hapnet.plots.files import png, save, save_figure
from hapnet.plots.histograms import lateness_histogram, link_histogram
from hapnet.plots.run import figure
from hapnet.reports.page import Source, page
from hapnet.reports.pictures import Picture, pictures
from hapnet.reports.tables import brief_text, summary_text
from hapnet.summary.words import legible, verdict

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
