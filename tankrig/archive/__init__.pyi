from .dataset import open_archive as open_archive
from .documents import documents_of as documents_of
from .documents import write_documents as write_documents
from .importing import import_run as import_run
from .nexus import export_nexus as export_nexus
from .runs import runs_in as runs_in
