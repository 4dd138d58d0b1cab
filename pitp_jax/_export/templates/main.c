/* @count@ samples of @what@, both ways, against the numbers of the program that wrote this; 0 where they agree. */
#include <math.h>
#include <stdio.h>

#include "@id@.h"

#define COUNT @count@u

typedef @id@_real real;

static const real voltage[COUNT] = {
@voltage@};
static const real displacement[COUNT] = {
@displacement@};
static const real target[COUNT][@UP@_TOKENS] = {
@targets@};
static const real planned[COUNT] = {
@planned@};

int main(void)
{
    @id@_state state;
    double worst = 0.0;
    double wrong = 0.0;
    @id@_init(&state, @rest@, @zero@);
    for (unsigned k = 0u; k < COUNT; k++) {
        const double apart = fabs((double)(@id@_predict_step(&state, voltage[k]) - displacement[k]));
        worst = (apart > worst) ? apart : worst;
    }
    @id@_init(&state, @rest@, @zero@);
    for (unsigned k = 0u; k < COUNT; k++) {
        uint32_t flags = 0u;
        const double u = (double)@id@_inverse_step(&state, target[k], &flags);
        const double apart = fabs(@force_error@);
        wrong = (apart > wrong) ? apart : wrong;
    }
    worst /= @range@;
    wrong /= @force_range@;
    (void)printf("predict_step: %.2g of the range, inverse_step: %.2g of the force\n", worst, wrong);
    return ((worst < @tolerance@) && (wrong < @force_tolerance@)) ? 0 : 1;
}
