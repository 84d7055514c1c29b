"""Threads that share the loops of kept kernels: the only part of Taichi's CPU runtime that their machine code calls.

A compiled loop calls ``parallel_for(pool, tasks, threads, context, function)``, which calls function(context, thread,
task) once for every task. Here that is written in LLVM's language, so that no compiler is needed.

A thread takes the next task by adding one to a ticket, of which the upper half is the number of the loop: a thread that
comes late, when its loop is over, cannot take a task of the next loop by mistake. So a loop ends when its tasks are
done, and does not wait for threads that had none. Workers look for the next loop for a while before they sleep, for
most loops follow each other closely.
"""

# Looks of 10 to 50 ns, before a worker sleeps, and before the caller sleeps until the workers are done.
WORKER_LOOKS, CALLER_LOOKS = 3000, 30000
_PAUSES = {"x86": "@llvm.x86.sse2.pause()", "arm": "@llvm.aarch64.hint(i32 1)"}
_TEXT = """
%body = type void (i8*, i32, i32)
%condition = type [256 x i8]                ; more than a mutex or a condition of pthreads takes

@threads = internal global i32 1            ; the caller and the workers
@ticket = internal global i64 0, align 64   ; number of the loop * 2^32 + number of its next task
@done = internal global i32 0, align 64     ; how many tasks of the loop are done
@tasks = internal global i32 0, align 64    ; how many the loop has
@context = internal global i8* null
@function = internal global %body* null
@sleeping = internal global i32 0, align 64 ; how many workers sleep
@waiting = internal global i32 0            ; whether the caller sleeps
@mutex = internal global %condition zeroinitializer, align 64
@begun = internal global %condition zeroinitializer, align 64
@ended = internal global %condition zeroinitializer, align 64

declare i32 @pthread_mutex_init(%condition*, i8*)
declare i32 @pthread_mutex_lock(%condition*)
declare i32 @pthread_mutex_unlock(%condition*)
declare i32 @pthread_cond_init(%condition*, i8*)
declare i32 @pthread_cond_wait(%condition*, %condition*)
declare i32 @pthread_cond_broadcast(%condition*)
declare i32 @pthread_create(i8**, i8*, i8* (i8*)*, i8*)
declare void PAUSE_TYPE

define i32 @start(i32 %threads) {
  call i32 @pthread_mutex_init(%condition* @mutex, i8* null)
  call i32 @pthread_cond_init(%condition* @begun, i8* null)
  call i32 @pthread_cond_init(%condition* @ended, i8* null)
  store i32 %threads, i32* @threads
  %handle = alloca i8*
  br label %head
head:
  %k = phi i32 [ 1, %0 ], [ %next, %create ]
  %more = icmp slt i32 %k, %threads
  br i1 %more, label %create, label %end
create:
  %wide = zext i32 %k to i64
  %number = inttoptr i64 %wide to i8*
  %error = call i32 @pthread_create(i8** %handle, i8* null, i8* (i8*)* @worker, i8* %number)
  %next = add i32 %k, 1
  %good = icmp eq i32 %error, 0
  br i1 %good, label %head, label %end
end:
  %result = phi i32 [ 0, %head ], [ %error, %create ]
  ret i32 %result
}

define i8* @worker(i8* %number) {
  %wide = ptrtoint i8* %number to i64
  %thread = trunc i64 %wide to i32
  br label %after
after:
  %last = phi i64 [ 0, %0 ], [ %loop, %work ]
  br label %look
look:
  %looks = phi i32 [ 0, %after ], [ %more, %pause ]
  %ticket = load atomic i64, i64* @ticket seq_cst, align 8
  %number1 = lshr i64 %ticket, 32
  %new1 = icmp ne i64 %number1, %last
  br i1 %new1, label %work, label %pause
pause:
  call void PAUSE
  %more = add i32 %looks, 1
  %tired = icmp sgt i32 %more, WORKER_LOOKS
  br i1 %tired, label %sleep, label %look
sleep:
  call i32 @pthread_mutex_lock(%condition* @mutex)
  atomicrmw add i32* @sleeping, i32 1 seq_cst
  br label %check
check:
  %ticket2 = load atomic i64, i64* @ticket seq_cst, align 8
  %number2 = lshr i64 %ticket2, 32
  %new2 = icmp ne i64 %number2, %last
  br i1 %new2, label %rise, label %wait
wait:
  call i32 @pthread_cond_wait(%condition* @begun, %condition* @mutex)
  br label %check
rise:
  atomicrmw sub i32* @sleeping, i32 1 seq_cst
  call i32 @pthread_mutex_unlock(%condition* @mutex)
  br label %work
work:
  %loop = phi i64 [ %number1, %look ], [ %number2, %rise ]
  call void @work(i32 %thread)
  br label %after
}

; What is read of the loop belongs to the ticket that was read before, if that is still the ticket.
define internal void @work(i32 %thread) {
  br label %look
look:
  %ticket = load atomic i64, i64* @ticket seq_cst, align 8
  %task = trunc i64 %ticket to i32
  %tasks = load atomic i32, i32* @tasks seq_cst, align 4
  %context = load atomic i8*, i8** @context seq_cst, align 8
  %function = load atomic %body*, %body** @function seq_cst, align 8
  %left = icmp ult i32 %task, %tasks
  br i1 %left, label %take, label %end
take:
  %next = add i64 %ticket, 1
  %pair = cmpxchg i64* @ticket, i64 %ticket, i64 %next seq_cst seq_cst
  %taken = extractvalue { i64, i1 } %pair, 1
  br i1 %taken, label %run, label %look
run:
  call void %function(i8* %context, i32 %thread, i32 %task)
  %before = atomicrmw add i32* @done, i32 1 seq_cst
  %after = add i32 %before, 1
  %last = icmp eq i32 %after, %tasks
  br i1 %last, label %tell, label %look
tell:
  %waiting = load atomic i32, i32* @waiting seq_cst, align 4
  %sleeps = icmp ne i32 %waiting, 0
  br i1 %sleeps, label %wake, label %end
wake:
  call i32 @pthread_mutex_lock(%condition* @mutex)
  call i32 @pthread_cond_broadcast(%condition* @ended)
  call i32 @pthread_mutex_unlock(%condition* @mutex)
  br label %end
end:
  ret void
}

define void @parallel_for(i8* %pool, i32 %tasks, i32 %wanted, i8* %context, %body* %function) {
  %threads = load i32, i32* @threads
  %alone = icmp eq i32 %threads, 1
  %short = icmp sle i32 %tasks, 1
  %serial = or i1 %alone, %short
  br i1 %serial, label %head, label %share
head:
  %k = phi i32 [ 0, %0 ], [ %next, %one ]
  %left = icmp slt i32 %k, %tasks
  br i1 %left, label %one, label %end
one:
  call void %function(i8* %context, i32 0, i32 %k)
  %next = add i32 %k, 1
  br label %head
share:                                      ; no ticket of the last loop is good while this one is described
  %old = load atomic i64, i64* @ticket seq_cst, align 8
  %closed = or i64 %old, 4294967295
  store atomic i64 %closed, i64* @ticket seq_cst, align 8
  store atomic i32 0, i32* @done seq_cst, align 4
  store atomic i32 %tasks, i32* @tasks seq_cst, align 4
  store atomic i8* %context, i8** @context seq_cst, align 8
  store atomic %body* %function, %body** @function seq_cst, align 8
  %new = add i64 %closed, 1
  store atomic i64 %new, i64* @ticket seq_cst, align 8
  %sleeping = load atomic i32, i32* @sleeping seq_cst, align 4
  %some = icmp ne i32 %sleeping, 0
  br i1 %some, label %wake, label %work
wake:
  call i32 @pthread_mutex_lock(%condition* @mutex)
  call i32 @pthread_cond_broadcast(%condition* @begun)
  call i32 @pthread_mutex_unlock(%condition* @mutex)
  br label %work
work:
  call void @work(i32 0)
  br label %look
look:
  %looks = phi i32 [ 0, %work ], [ %more, %pause ]
  %done1 = load atomic i32, i32* @done seq_cst, align 4
  %all1 = icmp eq i32 %done1, %tasks
  br i1 %all1, label %end, label %pause
pause:
  call void PAUSE
  %more = add i32 %looks, 1
  %tired = icmp sgt i32 %more, CALLER_LOOKS
  br i1 %tired, label %sleep, label %look
sleep:
  call i32 @pthread_mutex_lock(%condition* @mutex)
  store atomic i32 1, i32* @waiting seq_cst, align 4
  br label %check
check:
  %done2 = load atomic i32, i32* @done seq_cst, align 4
  %all2 = icmp eq i32 %done2, %tasks
  br i1 %all2, label %rise, label %wait
wait:
  call i32 @pthread_cond_wait(%condition* @ended, %condition* @mutex)
  br label %check
rise:
  store atomic i32 0, i32* @waiting seq_cst, align 4
  call i32 @pthread_mutex_unlock(%condition* @mutex)
  br label %end
end:
  ret void
}
"""


def text(machine: str) -> str:
    """The threads in LLVM's language, ``start(threads)`` and ``parallel_for``; x86-64 and ARM-64, else `ValueError`."""
    pauses = {"x86_64": _PAUSES["x86"], "AMD64": _PAUSES["x86"], "aarch64": _PAUSES["arm"], "arm64": _PAUSES["arm"]}
    if machine not in pauses:
        raise ValueError(f"no way to pause is known on {machine!r}")
    pause = pauses[machine]
    filled = _TEXT.replace("PAUSE_TYPE", pause.replace("i32 1", "i32")).replace("PAUSE", pause)
    return filled.replace("WORKER_LOOKS", str(WORKER_LOOKS)).replace("CALLER_LOOKS", str(CALLER_LOOKS))
