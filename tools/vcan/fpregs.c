/*
 * Lets a user-mode Linux older than 6.13 run on processors with AMX.
 *
 * Such a kernel keeps 2696 bytes of floating point state for each process. The host wants the
 * whole state in PTRACE_SETREGSET or nothing (EFAULT), and with AMX the whole is 11 KiB: the
 * first process in the user-mode Linux dies at once, "ptrace set fp regs failed, errno = 14".
 * Loaded with LD_PRELOAD, this ptrace() fills the state up to the host's size. What is filled up
 * is zero, marked as unused, and stays so: the user-mode Linux lets no process ask for AMX.
 *
 * Built and loaded by tools/vcan/uml.py, only where it is needed.
 */
#define _GNU_SOURCE
#include <elf.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#define XSTATE_HEADER 512                       /* offset of the bit mask of the parts in use */
#define XSTATE_AMX ((1ull << 17) | (1ull << 18)) /* tile configuration, tile data */

static unsigned char whole[1 << 16] __attribute__((aligned(64)));
static size_t whole_length; /* 0: not known yet */

static int find_whole_length(long pid)
{
	struct iovec part = {.iov_base = whole, .iov_len = sizeof whole};

	if (syscall(SYS_ptrace, PTRACE_GETREGSET, pid, NT_X86_XSTATE, &part) < 0)
		return -1;
	whole_length = part.iov_len;
	memset(whole, 0, sizeof whole);
	return 0;
}

static long set_fp_registers(long pid, const struct iovec *given)
{
	struct iovec part = *given;

	if (whole_length == 0 && find_whole_length(pid) < 0)
		return -1;
	if (given->iov_len < whole_length) {
		uint64_t in_use;

		memcpy(whole, given->iov_base, given->iov_len);
		memcpy(&in_use, whole + XSTATE_HEADER, sizeof in_use);
		in_use &= ~XSTATE_AMX;
		memcpy(whole + XSTATE_HEADER, &in_use, sizeof in_use);
		part.iov_base = whole;
		part.iov_len = whole_length;
	}
	return syscall(SYS_ptrace, PTRACE_SETREGSET, pid, NT_X86_XSTATE, &part);
}

long ptrace(enum __ptrace_request request, ...)
{
	va_list arguments;
	va_start(arguments, request);
	long pid = va_arg(arguments, pid_t);
	void *address = va_arg(arguments, void *);
	void *data = va_arg(arguments, void *);
	va_end(arguments);

	if (request == PTRACE_SETREGSET && (uintptr_t)address == NT_X86_XSTATE)
		return set_fp_registers(pid, data);
	if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) {
		long word = -1; /* the system call stores the word, the C function returns it */
		return syscall(SYS_ptrace, request, pid, address, &word) < 0 ? -1 : word;
	}
	return syscall(SYS_ptrace, request, pid, address, data);
}
