"""Methods of fault diagnosis against plants, in one table: ``gateway evaluate arena``.

``contract`` says what a plant and a method are; ``plants`` and ``methods`` have them, a file a kind; ``trial`` runs
and ``score`` judges them. A method of a stranger's is one file: ``--method FILE.py:CLASS``.
"""
