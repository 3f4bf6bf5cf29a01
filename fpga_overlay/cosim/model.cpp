// A verilated AXI4-Stream core behind a small C interface, for ctypes. Built by verilated.py with --prefix Vtop.
//
// Ports: clk, rst_n, {s,m}_axis_{tdata[127:0],tvalid,tready,tlast}. A beat is four little-endian 32-bit words.

#include <cstdint>
#include <cstring>
#include <memory>

#include "Vtop.h"
#include "verilated.h"

namespace {

constexpr int kWords = 4;

enum Outcome : int32_t { kDone = 0, kHung = 1, kOverflow = 2, kUnstable = 3 };

struct Random {  // xorshift64*: one stream for each side, so that one's pattern does not depend on the other's
    uint64_t state;
    explicit Random(uint64_t seed) : state(seed * 0x9E3779B97F4A7C15ull + 1) {}
    bool below(uint32_t threshold) {
        state ^= state >> 12, state ^= state << 25, state ^= state >> 27;
        return static_cast<uint32_t>(state * 0x2545F4914F6CDD1Dull >> 32) < threshold;
    }
};

struct Core {
    VerilatedContext context;
    std::unique_ptr<Vtop> top;

    explicit Core(int32_t seed) {
        context.randReset(2);  // registers wake up with anything in them, as far as the model allows
        context.randSeed(seed);
        top = std::make_unique<Vtop>(&context);
        top->clk = 0, top->rst_n = 0;
        top->s_axis_tvalid = 0, top->s_axis_tlast = 0, top->m_axis_tready = 0;
        top->eval();
    }
    ~Core() { top->final(); }

    void fall() { top->clk = 0, top->eval(); }
    void rise() { top->clk = 1, top->eval(), context.timeInc(1); }
};

struct Beat {  // what a source offers and must not change before it is taken
    uint32_t words[kWords];
    bool last;
    bool operator!=(const Beat& other) const { return std::memcmp(words, other.words, sizeof words) || last != other.last; }
};

Beat offered(const Vtop& top) {
    Beat beat{};
    for (int i = 0; i < kWords; ++i) beat.words[i] = top.m_axis_tdata[i];
    beat.last = top.m_axis_tlast;
    return beat;
}

}  // namespace

extern "C" {

// What goes in and what comes out; idle and stall are chances of 2^-32 that a side pauses for a clock.
struct Exchange {
    const uint32_t* in;
    const uint8_t* in_last;
    int64_t in_beats;
    uint32_t* out;
    uint8_t* out_last;
    int64_t out_capacity;
    int64_t out_packets;  // ends when that many TLAST have come and all is taken
    int64_t max_cycles;
    uint32_t idle, stall, seed;
    int64_t taken, given, cycles;  // results
};

void* core_new(int32_t seed) { return new Core(seed); }

void core_delete(void* core) { delete static_cast<Core*>(core); }

// Holds reset, then waits until the core takes data; returns the clocks that took, -1 if it never does.
int64_t core_reset(void* handle, int64_t held, int64_t max_cycles) {
    Core& core = *static_cast<Core*>(handle);
    core.top->rst_n = 0, core.top->s_axis_tvalid = 0, core.top->m_axis_tready = 0;
    for (int64_t i = 0; i < held; ++i) core.fall(), core.rise();
    core.top->rst_n = 1;
    for (int64_t i = 0; i < max_cycles; ++i) {
        core.fall();
        const bool ready = core.top->s_axis_tready;
        core.rise();
        if (ready) return i;
    }
    return -1;
}

int32_t core_exchange(void* handle, Exchange* x) {
    Core& core = *static_cast<Core*>(handle);
    Vtop& top = *core.top;
    Random idle(2ull * x->seed), stall(2ull * x->seed + 1);
    Beat waiting{};
    bool was_waiting = false, offering = false;
    int64_t packets = 0;
    x->taken = x->given = x->cycles = 0;
    while (x->taken < x->in_beats || packets < x->out_packets) {
        if (x->cycles == x->max_cycles) return kHung;
        if (!offering && x->taken < x->in_beats && !idle.below(x->idle)) {  // once offered, a beat stays offered
            offering = true;
            for (int i = 0; i < kWords; ++i) top.s_axis_tdata[i] = x->in[kWords * x->taken + i];
            top.s_axis_tlast = x->in_last[x->taken];
        }
        top.s_axis_tvalid = offering;
        top.m_axis_tready = !stall.below(x->stall);
        core.fall();
        if (was_waiting && (!top.m_axis_tvalid || offered(top) != waiting)) return kUnstable;
        was_waiting = top.m_axis_tvalid && !top.m_axis_tready;
        if (was_waiting) waiting = offered(top);
        if (top.m_axis_tvalid && top.m_axis_tready) {
            if (x->given == x->out_capacity) return kOverflow;
            const Beat beat = offered(top);
            std::memcpy(x->out + kWords * x->given, beat.words, sizeof beat.words);
            x->out_last[x->given++] = beat.last;
            packets += beat.last;
        }
        if (offering && top.s_axis_tready) ++x->taken, offering = false;
        core.rise();
        ++x->cycles;
    }
    top.s_axis_tvalid = 0, top.m_axis_tready = 0;
    return kDone;
}

}  // extern "C"
