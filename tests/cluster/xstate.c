/* Lets user-mode Linux 6.1 start on processors with AMX, preloaded into it.
 *
 * It keeps a process's vector registers in a buffer that is too small for those of AMX, which nobody uses there, and the
 * system takes nothing but all of them. What it gives is laid over what the process has.
 */
#define _GNU_SOURCE
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

static long ask(long request, long process, void *address, void *data)
{
	return syscall(SYS_ptrace, request, process, address, data);
}

long ptrace(enum __ptrace_request request, ...)
{
	static __thread char all[1 << 16];
	struct iovec whole = {all, sizeof all}, *given;
	va_list rest;
	va_start(rest, request);
	long process = va_arg(rest, pid_t);
	void *address = va_arg(rest, void *), *data = va_arg(rest, void *);
	va_end(rest);
	if (request >= PTRACE_PEEKTEXT && request <= PTRACE_PEEKUSER) {
		long word, problem = ask(request, process, address, &word);
		return problem ? problem : word;
	}
	if (request == PTRACE_SETREGSET && (long)address == NT_X86_XSTATE) {
		given = data;
		long problem = ask(PTRACE_GETREGSET, process, address, &whole);
		if (problem)
			return problem;
		if (given->iov_len < whole.iov_len) {
			memcpy(all, given->iov_base, given->iov_len);
			data = &whole;
		}
	}
	return ask(request, process, address, data);
}
