// Presses the model organ in C#, and prints the force of the last period, and which calls a disposed one refuses.
using System;

static class Steps
{
    static int Main(string[] arguments)
    {
        using (var organ = new Palpate.Organ(arguments[0]))
        {
            if (organ.SetBall(0, 0.015, 0.024, 0.038, 0.046, 0.3) != 0) return 1;
            for (int k = 0; k < 200; k++)
            {
                organ.SetPose(0, 0, 0, -0.005 * Math.Min(1, k / 100.0));
                if (organ.Step() != 0) return 2;
            }
            double[] force = organ.Force(0);
            Console.WriteLine("{0:R} {1:R} {2:R}", force[0], force[1], force[2]);
            Console.WriteLine("{0} {1}", organ.Vertices().Length, organ.Triangles().Length);
        }
        var disposed = new Palpate.Organ(arguments[0]);
        disposed.Dispose();
        disposed.Dispose();
        Action[] calls =
        {
            () => disposed.Step(), () => disposed.Reset(), () => disposed.SetPose(0, 0, 0, 0), () => disposed.Force(0),
            () => disposed.SetBall(0, 0.01, 0, 0, 0), () => disposed.Position(0), () => disposed.Vertices(),
            () => disposed.Triangles(), () => disposed.ForceBound(0), () => Console.WriteLine(disposed.TrustNumber)
        };
        int refused = 0;
        foreach (var call in calls)
            try { call(); }
            catch (ObjectDisposedException error) { refused += error.Message.Contains("make a new Organ") ? 1 : 0; }
        Console.WriteLine("{0} of {1}", refused, calls.Length);
        try { new Palpate.Organ(arguments[1]); }
        catch (System.IO.InvalidDataException error) { Console.WriteLine(error.Message.Contains("must be")); }
        return 0;
    }
}
