"""Diagnosis of real robots from public recordings whose causes are documented, and its page: `via gap real`."""
