"""One run or several as a single HTML page that needs no network: gathered from run folders, thinned to a stated size.

`gather` turns a run folder into plain data, `page` turns that data into the file. Nothing is computed anew here: what a
run folder does not hold is named on the page, with the command that would make it.
"""
