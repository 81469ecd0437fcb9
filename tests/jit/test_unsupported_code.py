"""Kernels that call themselves are refused; a name of a record's field is no call."""

import pytest

from gateway_fdi.errors import KernelError
from gateway_fdi.jit import kernel
from gateway_fdi.jit.unsupported_code import refuse


@kernel
def patience_ns(p):
    return int(p.patience_ns)


@kernel
def own_field(p):
    return patience_ns(p)


@kernel
def again(n):
    return again(n - 1) if n > 0 else 0


def test_a_helper_may_have_the_name_of_the_field_that_it_reads():
    refuse(own_field)


def test_a_kernel_that_calls_itself_is_refused():
    with pytest.raises(KernelError, match="again .* calls itself"):
        refuse(again)
