"""Turn files of every format into columns with names, units and numbers, and choose the columns.

    file -> guard (size, links, archives) -> possible tables -> choice of time, input and output

Certain columns are recognised. For the others the user is asked, with a command that answers the question. The user's
options take precedence.
"""
